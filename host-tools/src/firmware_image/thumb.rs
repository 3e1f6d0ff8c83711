//! Decoder for Thumb-2 instructions that affect calls and the stack.
//!
//! Encodings: "ARMv7-M Architecture Reference Manual" (DDI 0403), chapter A7. Instructions that are not decoded here
//! neither call nor move the stack pointer down, except arithmetic on a copy of the stack pointer, which
//! [`Effect::StackFrom`] then cannot trace.

/// Effect of an instruction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Effect {
    /// Allocates this many bytes of the stack.
    Stack(u32),
    /// Makes a register point this many bytes below the stack pointer.
    Below(u8, u32),
    /// Clears this many of a register's lowest bits.
    Align(u8, u32),
    /// Sets the stack pointer to a register.
    StackFrom(u8),
    /// Calls the function at an address.
    Call(u32),
    /// Continues at an address: within the function, or in another function that returns to the caller.
    Jump(u32),
    /// Calls the address in a register, or continues there.
    Indirect,
    /// Loads a 16-bit constant into a register; the flag selects the upper half.
    Constant(u8, u16, bool),
    /// Allocates as many bytes of the stack as a register contains.
    StackRegister(u8),
    /// Masks interrupts: CPSID, or a write to PRIMASK, BASEPRI or FAULTMASK.
    Mask,
    /// No relevant effect.
    Other,
}

const STACK_POINTER: u16 = 13;

/// Bytes of the instruction that begins with this halfword.
pub(super) fn length(first: u16) -> u32 {
    if first >> 11 >= 0b11101 { 4 } else { 2 }
}

/// Effect of the instruction at `address`; `second` is the halfword after `first`.
pub(super) fn decode(address: u32, first: u16, second: u16) -> Effect {
    match length(first) {
        2 => decode_16(address, first),
        _ => decode_32(address, first, second),
    }
}

fn decode_16(address: u32, code: u16) -> Effect {
    let after = address.wrapping_add(4);
    match code {
        // PUSH
        0xB400..=0xB5FF => Effect::Stack(4 * (code & 0x1FF).count_ones()),
        // SUB SP, #imm7
        0xB080..=0xB0FF => Effect::Stack(4 * u32::from(code & 0x7F)),
        // CPSID
        0xB670..=0xB673 => Effect::Mask,
        // BLX and BX of a register; BX LR returns
        0x4700..=0x47FF if code & 7 == 0 => match code & 0xF8 {
            0x70 => Effect::Other,
            _ => Effect::Indirect,
        },
        // MOV SP, Rm
        0x4600..=0x46FF if code & 0x87 == 0x85 => Effect::StackFrom((code >> 3 & 0xF) as u8),
        // MOV Rd, SP
        0x4600..=0x46FF if code >> 3 & 0xF == STACK_POINTER => Effect::Below(low_register(code), 0),
        // B with a condition
        0xD000..=0xDDFF => Effect::Jump(after.wrapping_add_signed(i32::from(code as u8 as i8) << 1)),
        // B
        0xE000..=0xE7FF => Effect::Jump(after.wrapping_add_signed(sign_extended(u32::from(code & 0x7FF) << 1, 12))),
        _ => Effect::Other,
    }
}

fn decode_32(address: u32, first: u16, second: u16) -> Effect {
    match first {
        // STMDB SP!, PUSH.W
        0xE92D => Effect::Stack(4 * second.count_ones()),
        // STRD with a lowered stack pointer
        0xE96D => Effect::Stack(4 * u32::from(second & 0xFF)),
        // STR with a lowered stack pointer
        0xF84D if second & 0x0F00 == 0x0D00 => Effect::Stack(u32::from(second & 0xFF)),
        // VPUSH
        0xED2D | 0xED6D if second & 0x0E00 == 0x0A00 => Effect::Stack(4 * u32::from(second & 0xFF)),
        // SUB.W SP, SP, #constant
        0xF1AD | 0xF5AD if destination(second) == STACK_POINTER => Effect::Stack(expanded(first, second)),
        0xF1AD | 0xF5AD => Effect::Below(destination(second) as u8, expanded(first, second)),
        // BFC from bit 0 on
        0xF36F if second & 0x70C0 == 0 => Effect::Align(destination(second) as u8, u32::from(second & 0x1F) + 1),
        // SUBW SP, SP, #imm12
        0xF2AD | 0xF6AD if destination(second) == STACK_POINTER => Effect::Stack(immediate_12(first, second)),
        // SUB.W SP, SP, Rm
        0xEBAD if destination(second) == STACK_POINTER && second & 0x70F0 == 0 => {
            Effect::StackRegister((second & 0xF) as u8)
        }
        // MOVW, MOVT
        _ if first & 0xFBF0 == 0xF240 => {
            Effect::Constant((destination(second)) as u8, immediate_16(first, second), false)
        }
        _ if first & 0xFBF0 == 0xF2C0 => {
            Effect::Constant((destination(second)) as u8, immediate_16(first, second), true)
        }
        // MSR PRIMASK, BASEPRI, BASEPRI_MAX, FAULTMASK
        _ if first & 0xFFF0 == 0xF380 && second & 0xFF00 == 0x8800 && (0x10..=0x13).contains(&(second & 0xFF)) => {
            Effect::Mask
        }
        // LDR PC, [...]: a long branch of the linker, or a table
        _ if first & 0xFF70 == 0xF850 && second & 0xF000 == 0xF000 && first & 0xF != STACK_POINTER => Effect::Indirect,
        _ if first & 0xF800 == 0xF000 && second & 0x8000 != 0 => branch(address, first, second),
        _ => Effect::Other,
    }
}

fn branch(address: u32, first: u16, second: u16) -> Effect {
    let after = address.wrapping_add(4);
    let sign = u32::from(first >> 10 & 1);
    let (j1, j2) = (u32::from(second >> 13 & 1), u32::from(second >> 11 & 1));
    let low = u32::from(second & 0x7FF) << 1;
    if second & 0x5000 == 0 {
        // B.W with a condition; the conditions 14 and 15 are other instructions
        if first >> 6 & 0xF >= 14 {
            return Effect::Other;
        }
        let offset = sign << 20 | j2 << 19 | j1 << 18 | u32::from(first & 0x3F) << 12 | low;
        return Effect::Jump(after.wrapping_add_signed(sign_extended(offset, 21)));
    }
    let (i1, i2) = (1 ^ j1 ^ sign, 1 ^ j2 ^ sign);
    let offset = sign << 24 | i1 << 23 | i2 << 22 | u32::from(first & 0x3FF) << 12 | low;
    let target = after.wrapping_add_signed(sign_extended(offset, 25));
    match second & 0x5000 {
        0x1000 => Effect::Jump(target),
        0x5000 => Effect::Call(target),
        _ => Effect::Other,
    }
}

/// The destination of a 16-bit MOV, whose highest bit is separate.
fn low_register(code: u16) -> u8 {
    (code & 7 | code >> 4 & 8) as u8
}

fn destination(second: u16) -> u16 {
    second >> 8 & 0xF
}

fn immediate_12(first: u16, second: u16) -> u32 {
    u32::from(first >> 10 & 1) << 11 | u32::from(second >> 12 & 7) << 8 | u32::from(second & 0xFF)
}

fn immediate_16(first: u16, second: u16) -> u16 {
    (first & 0xF) << 12 | immediate_12(first, second) as u16
}

/// A modified constant: a byte in one of four patterns, or eight bits with a leading one, rotated.
fn expanded(first: u16, second: u16) -> u32 {
    let code = immediate_12(first, second);
    let byte = code & 0xFF;
    match code >> 8 {
        0 => byte,
        1 => byte << 16 | byte,
        2 => byte << 24 | byte << 8,
        3 => byte << 24 | byte << 16 | byte << 8 | byte,
        _ => (byte | 0x80).rotate_right(code >> 7),
    }
}

fn sign_extended(value: u32, bits: u32) -> i32 {
    let shift = u32::BITS - bits;
    (value << shift) as i32 >> shift
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pushes_and_subtractions_take_the_stack_they_say() {
        for (first, second, bytes) in [
            (0xB5F0, 0, 20),         // push {r4-r7, lr}
            (0xB082, 0, 8),          // sub sp, #8
            (0xE92D, 0x4FF0, 36),    // push.w {r4-r11, lr}
            (0xF84D, 0x8D04, 4),     // str r8, [sp, #-4]!
            (0xED2D, 0x8B10, 64),    // vpush {d8-d15}
            (0xF5AD, 0x7D2A, 680),   // sub.w sp, sp, #680
            (0xF2AD, 0x4D2C, 0x42C), // subw sp, sp, #1068
        ] {
            assert_eq!(
                decode(0x0800_0000, first, second),
                Effect::Stack(bytes),
                "{first:04x} {second:04x}"
            );
        }
    }

    #[test]
    fn branches_lead_where_the_manual_says() {
        // bl +0x100 and -0x100 from 0x1000, b.w +0x10, bne.w -2, b -4, beq +8
        assert_eq!(decode(0x1000, 0xF000, 0xF87E), Effect::Call(0x1100));
        assert_eq!(decode(0x1000, 0xF7FF, 0xFF7E), Effect::Call(0x0F00));
        assert_eq!(decode(0x1000, 0xF000, 0xB806), Effect::Jump(0x1010));
        assert_eq!(decode(0x1000, 0xF47F, 0xAFFD), Effect::Jump(0x0FFE));
        assert_eq!(decode(0x1000, 0xE7FC, 0), Effect::Jump(0x0FFC));
        assert_eq!(decode(0x1000, 0xD002, 0), Effect::Jump(0x1008));
    }

    #[test]
    fn returns_and_barriers_are_no_calls_and_masks_are_seen() {
        assert_eq!(decode(0, 0x4770, 0), Effect::Other); // bx lr
        assert_eq!(decode(0, 0x4780, 0), Effect::Indirect); // blx r0
        assert_eq!(decode(0, 0xF3BF, 0x8F4F), Effect::Other); // dsb
        assert_eq!(decode(0, 0xB672, 0), Effect::Mask); // cpsid i
        assert_eq!(decode(0, 0xF380, 0x8812), Effect::Mask); // msr basepri_max, r0
        assert_eq!(decode(0, 0xF240, 0x1C34), Effect::Constant(12, 0x134, false)); // movw ip, #0x134
    }

    #[test]
    fn a_frame_that_is_aligned_is_traced() {
        assert_eq!(decode(0, 0x466C, 0), Effect::Below(4, 0)); // mov r4, sp
        assert_eq!(decode(0, 0x46E8, 0), Effect::Below(8, 0)); // mov r8, sp
        assert_eq!(decode(0, 0xF5AD, 0x747A), Effect::Below(4, 1000)); // sub.w r4, sp, #1000
        assert_eq!(decode(0, 0xF36F, 0x0404), Effect::Align(4, 5)); // bfc r4, #0, #5
        assert_eq!(decode(0, 0x46A5, 0), Effect::StackFrom(4)); // mov sp, r4
    }

    #[test]
    fn no_halfwords_make_the_decoder_fail() {
        for first in 0..=u16::MAX {
            for second in [0, 0x5555, 0xAAAA, 0xFFFF] {
                decode(u32::MAX, first, second);
            }
        }
    }
}
