"""A Cortex-M7 with memories, virtual time and exceptions around unicorn's instruction set; the chip is in chip.py.

Time is virtual: it goes on by the instructions that were run and by every access to a register. A loop that only reads
is made short: from some reads on without a write between them, each one takes longer.
"""

import random
import struct

import registers
from unicorn import UC_ARCH_ARM, UC_HOOK_BLOCK, UC_HOOK_INSN_INVALID, UC_MODE_MCLASS, UC_MODE_THUMB, Uc, UcError
from unicorn import arm_const as arm

# Memories of the chip: start and size.
FLASH = (0x0800_0000, 0x20_0000)
RAMS = [(0x0000_0000, 0x1_0000), (0x2000_0000, 0x2_0000), (0x2400_0000, 0x8_0000), (0x3800_0000, 0x1_0000)]
# Bit of RCC.AHB2ENR that clocks it, start, size: without its clock it is not there.
CLOCKED_RAMS = [(29, 0x3000_0000, 0x2_0000), (30, 0x3002_0000, 0x2_0000), (31, 0x3004_0000, 0x8000)]
UNIQUE_NUMBER = (0x1FF1_E000, 0x1000)
MMIO = [(0x4000_0000, 0x10_0000), (0x5200_0000, 0x1_0000), (0x5800_0000, 0x10_0000), (0x5C00_0000, 0x1_0000), (0xE000_0000, 0x1_0000)]

# Reads without a write between them that take the time of an access; each later one takes POLL_US.
QUICK_READS = 64
POLL_US = 200.0
ACCESS_US = 0.02
WFI = b"\x30\xbf"
NEVER = float("inf")
# Execution priority of code that no exception interrupted.
THREAD = 256
NMI = 2
EXC_RETURN_FRAME_WITH_FLOATS = 0xFFFF_FFE9
FRAME_REGISTERS = [arm.UC_ARM_REG_R0, arm.UC_ARM_REG_R1, arm.UC_ARM_REG_R2, arm.UC_ARM_REG_R3, arm.UC_ARM_REG_R12, arm.UC_ARM_REG_LR]
FLOATS = [arm.UC_ARM_REG_D0 + n for n in range(8)]
DOUBLES = [arm.UC_ARM_REG_D0 + n for n in range(16)] + [arm.UC_ARM_REG_FPSCR]


class Stop(Exception):
    """The run has come to its end; the text says why."""


class Machine:
    """The core and its memories. `chip` models the registers."""

    def __init__(self, image, chip, seed):
        self.chip, self.random = chip, random.Random(seed)
        self.now_us, self.core_mhz = 0.0, 64.0
        self.reads_since_write = 0
        self.gathered = {}
        self.lines = []
        self.pending, self.enabled, self.active = set(), set(), []
        self.nmi = False
        self.fatal = None
        self.end_at_us = NEVER
        self.sleeps = 0
        self.uc = Uc(UC_ARCH_ARM, UC_MODE_THUMB | UC_MODE_MCLASS)
        self.uc.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M7)
        self.uc.mem_map(*FLASH)
        for start, size in RAMS:
            self.uc.mem_map(start, size)
            self.uc.mem_write(start, self.random.randbytes(size))
        self.mapped = set()
        self.uc.mem_map(*UNIQUE_NUMBER)
        self.uc.mem_write(0x1FF1_E800, bytes(range(0x30, 0x3C)))
        for start, size in MMIO:
            self.uc.mmio_map(start, size, self._read, start, self._write, start)
        for address, data in loads(image):
            self.uc.mem_write(address, data)
        self.uc.hook_add(UC_HOOK_BLOCK, self._block)
        self.doubles = Doubles()
        self.uc.hook_add(UC_HOOK_INSN_INVALID, self._double)
        chip.machine = self
        chip.reset("power-on")

    # What happened, for the reader.

    def say(self, line):
        """Adds a line to the trace, behind what was read before it."""
        for name, value in self.gathered.items():
            self.lines.append(f"read {name} {value:#010x}")
        self.gathered.clear()
        self.lines.append(line)

    def _read(self, _uc, offset, size, start):
        address = start + offset
        word = address & ~3
        name = registers.name(word)
        # The check of all priorities reads the NVIC a thousand times, which is no wait.
        self.reads_since_write += not name.startswith("NVIC.")
        self.now_us += ACCESS_US if self.reads_since_write < QUICK_READS else POLL_US
        value = self.chip.read(name, word)
        if not name.startswith("SYST."):
            self.gathered.pop(name, None)
            self.gathered[name] = value
        if self.fatal:
            self.uc.emu_stop()
        return value >> 8 * (address & 3) & (1 << 8 * size) - 1

    def _write(self, _uc, offset, size, value, start):
        address = start + offset
        self.now_us += ACCESS_US
        word, shift = address & ~3, 8 * (address & 3)
        name = registers.name(word)
        if size < 4:
            mask = (1 << 8 * size) - 1 << shift
            value = self.chip.registers.get(name, 0) & ~mask | value << shift & mask
        # Feeding the watchdog and setting the cache up by set and way is no news.
        if not (name == "IWDG1.KR" and value == 0xAAAA) and name not in ("SCB.DCISW", "SCB.DCCMVAC"):
            self.say(f"write {name} {value:#010x}")
            self.reads_since_write = 0
        self.chip.write(name, word, value)
        if self.fatal:
            self.uc.emu_stop()

    def _block(self, uc, _address, size, _data):
        # Two to four bytes an instruction, one or two instructions a clock.
        self.now_us += size / 2 / self.core_mhz
        if self.now_us >= self.chip.next_us:
            self.chip.advance()
        is_over = self.now_us >= self.end_at_us
        if is_over or self.fatal or self.nmi or self.pending and self._next_exception() is not None:
            uc.emu_stop()

    def _double(self, uc, _data):
        """An instruction that unicorn's Cortex-M7 lacks: those for double precision, whose top halfword says so."""
        at = uc.reg_read(arm.UC_ARM_REG_PC) & ~1
        code = bytes(uc.mem_read(at, 4))
        if code[1] & 0xEE != 0xEE or code[3] & 0x0F != 0x0B:
            return False
        uc.reg_write_batch(list(zip(DOUBLES, self.doubles.run(code, uc.reg_read_batch(DOUBLES)))))
        psr = uc.reg_read(arm.UC_ARM_REG_XPSR)
        block = psr >> 25 & 3 | psr >> 8 & 0xFC
        if block:
            # The next instruction of an IT block.
            block = 0 if block & 7 == 0 else block & 0xE0 | block << 1 & 0x1F
            uc.reg_write(arm.UC_ARM_REG_XPSR, psr & ~(3 << 25 | 0xFC << 8) | (block & 3) << 25 | (block & 0xFC) << 8)
        uc.reg_write(arm.UC_ARM_REG_PC, at + 4 | 1)
        return True

    def map_clocked(self, bits):
        """Makes the memories that are clocked answer; their contents are random at first."""
        for bit, start, size in CLOCKED_RAMS:
            if bits >> bit & 1 and start not in self.mapped:
                self.mapped.add(start)
                self.uc.mem_map(start, size)
                self.uc.mem_write(start, self.random.randbytes(size))

    def fill_log(self, block):
        """What a debug probe leaves behind that has asked for waiting writes and reads no more: a full buffer."""
        size, written = struct.unpack("<2I", self.uc.mem_read(block + 32, 8))
        self.uc.mem_write(block + 40, struct.pack("<2I", (written + 1) % size, 2))

    # Exceptions: fetched from the vector table, stacked with the floating-point registers, by priority.

    def _priority(self):
        priority = min([THREAD] + [priority for _, priority in self.active])
        mask = self.uc.reg_read(arm.UC_ARM_REG_BASEPRI)
        if mask:
            priority = min(priority, mask)
        if self.uc.reg_read(arm.UC_ARM_REG_PRIMASK) & 1:
            priority = min(priority, 0)
        return priority

    def _next_exception(self):
        candidates = self.pending & self.enabled
        if not candidates:
            return None
        best = min(candidates, key=lambda number: (self.chip.interrupt_priority(number), number))
        return best if self.chip.interrupt_priority(best) < self._priority() else None

    def _enter(self, number, priority):
        uc = self.uc
        stack = uc.reg_read(arm.UC_ARM_REG_SP)
        aligned = (stack - 26 * 4) & ~7
        pad = (stack - 26 * 4 - aligned) // 4
        psr = uc.reg_read(arm.UC_ARM_REG_XPSR) & ~(1 << 9) | pad << 9 | 1 << 24
        words = [uc.reg_read(register) for register in FRAME_REGISTERS] + [uc.reg_read(arm.UC_ARM_REG_PC) & ~1, psr]
        frame = struct.pack("<8I", *words)
        frame += struct.pack("<8Q", *(uc.reg_read(register) for register in FLOATS))
        frame += struct.pack("<2I", uc.reg_read(arm.UC_ARM_REG_FPSCR), 0)
        uc.mem_write(aligned, frame)
        vector = uc.mem_read(self.chip.registers["SCB.VTOR"] + 4 * number, 4)
        self.active.append((number, priority))
        uc.reg_write(arm.UC_ARM_REG_SP, aligned)
        uc.reg_write(arm.UC_ARM_REG_LR, EXC_RETURN_FRAME_WITH_FLOATS)
        uc.reg_write(arm.UC_ARM_REG_PC, struct.unpack("<I", vector)[0] | 1)

    def _leave(self):
        uc = self.uc
        stack = uc.reg_read(arm.UC_ARM_REG_SP)
        frame = bytes(uc.mem_read(stack, 26 * 4))
        words = struct.unpack("<8I", frame[:32])
        for register, value in zip(FRAME_REGISTERS, words):
            uc.reg_write(register, value)
        for register, value in zip(FLOATS, struct.unpack("<8Q", frame[32:96])):
            uc.reg_write(register, value)
        uc.reg_write(arm.UC_ARM_REG_FPSCR, struct.unpack("<I", frame[96:100])[0])
        uc.reg_write(arm.UC_ARM_REG_SP, stack + 26 * 4 + 4 * (words[7] >> 9 & 1))
        uc.reg_write(arm.UC_ARM_REG_XPSR, words[7] & ~(1 << 9))
        uc.reg_write(arm.UC_ARM_REG_PC, words[6] | 1)
        self.active.pop()

    # Running.

    def reset(self):
        """The core after a reset; memory stays as it is."""
        uc = self.uc
        for start in sorted(self.mapped):
            uc.mem_unmap(start, next(size for _, at, size in CLOCKED_RAMS if at == start))
        self.mapped.clear()
        self.pending, self.enabled, self.active, self.nmi = set(), set(), [], False
        self.core_mhz, self.sleeps = 64.0, 0
        stack, entry = struct.unpack("<2I", uc.mem_read(FLASH[0], 8))
        for register in [arm.UC_ARM_REG_PRIMASK, arm.UC_ARM_REG_BASEPRI, arm.UC_ARM_REG_CONTROL]:
            uc.reg_write(register, 0)
        uc.reg_write(arm.UC_ARM_REG_SP, stack)
        uc.reg_write(arm.UC_ARM_REG_LR, 0xFFFF_FFFF)
        uc.reg_write(arm.UC_ARM_REG_PC, entry | 1)

    def run(self, until_us, first_sleep_ends):
        """Runs to a virtual time, or to the first WFI; says why it ended."""
        self.end_at_us = until_us
        self.reset()
        while True:
            if self.now_us >= until_us:
                return "time is over"
            if self.fatal:
                reason, self.fatal = self.fatal, None
                if reason.startswith("reset "):
                    self.chip.reset(reason.removeprefix("reset "))
                    self.reset()
                    continue
                return reason
            if self.nmi:
                self.nmi = False
                self._enter(NMI, -2)
            elif self.pending and (number := self._next_exception()) is not None:
                self.pending.discard(number)
                self._enter(16 + number, self.chip.interrupt_priority(number))
            at = self.uc.reg_read(arm.UC_ARM_REG_PC) & ~1
            try:
                self.uc.emu_start(at | 1, 0xFFFF_FFFE)
            except UcError as error:
                at = self.uc.reg_read(arm.UC_ARM_REG_PC)
                if at >= 0xFFFF_FF00 and self.active:
                    self._leave()
                    continue
                return f"fault at {at:#010x}: {error}"
            if self._is_asleep():
                self.sleeps += 1
                if self.sleeps == 1:
                    self.say("wfi")
                if first_sleep_ends:
                    return "first wfi"
                self._sleep()

    def _is_asleep(self):
        at = self.uc.reg_read(arm.UC_ARM_REG_PC) & ~1
        return not self.fatal and self.now_us < self.end_at_us and bytes(self.uc.mem_read(at - 2, 2)) == WFI

    def _sleep(self):
        """Until something is pending that would be taken with interrupts enabled."""
        while not (self.fatal or self.nmi or self.pending & self.enabled):
            if self.chip.next_us == NEVER or self.now_us >= self.end_at_us:
                self.now_us = max(self.now_us, self.end_at_us)
                return
            self.now_us = max(self.now_us, self.chip.next_us)
            self.chip.advance()


class Doubles:
    """A second core, of another profile, that knows the instructions for double precision; they have one encoding."""

    def __init__(self):
        self.uc = Uc(UC_ARCH_ARM, UC_MODE_THUMB)
        self.uc.ctl_set_cpu_model(arm.UC_CPU_ARM_MAX)
        self.uc.mem_map(0, 0x1_0000)
        self.uc.reg_write(arm.UC_ARM_REG_C1_C0_2, self.uc.reg_read(arm.UC_ARM_REG_C1_C0_2) | 0xF << 20)
        self.uc.reg_write(arm.UC_ARM_REG_FPEXC, 1 << 30)
        self.places = {}

    def run(self, code, values):
        """Runs an instruction on these registers; gives what they are then."""
        at = self.places.get(code)
        if at is None:
            at = self.places[code] = 4 * len(self.places)
            self.uc.mem_write(at, code)
        self.uc.reg_write_batch(list(zip(DOUBLES, values)))
        self.uc.emu_start(at | 1, at + 4)
        return self.uc.reg_read_batch(DOUBLES)


def loads(path):
    """Address and bytes of what an ELF file loads, at its physical addresses."""
    with open(path, "rb") as file:
        data = file.read()
    if data[:5] != b"\x7fELF\x01":
        raise Stop(f"{path} is no 32-bit ELF file")
    offset, size, count = struct.unpack_from("<I", data, 28)[0], *struct.unpack_from("<2H", data, 42)
    for number in range(count):
        kind, at, _, physical, length = struct.unpack_from("<5I", data, offset + number * size)
        if kind == 1 and length:
            yield physical, data[at : at + length]
