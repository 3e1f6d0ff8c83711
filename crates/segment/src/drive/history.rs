//! Diagnosis history of a drive: object 0x10F3, a ring of messages (ETG.1020).
//!
//! Sub-index 1 is the room, 2 the sub-index of the newest message, 3 that of the newest acknowledged one, 4 whether there are
//! newer ones, 5 the flags of the history; the messages follow. Here every emergency leaves a message.

/// Messages that a drive keeps.
pub(crate) const ROOM: u8 = 8;
/// Sub-index of the first message.
const FIRST: u8 = 6;
/// Low word of the code of a message about an emergency; the upper word is the error code.
const CODE_EMERGENCY: u32 = 0xE800;
/// Flags of a message: an error, with one parameter.
const FLAGS_ERROR: u16 = 0x0102;
/// Flags of the parameter: 2 bytes, unsigned.
const PARAMETER_WORD: u16 = 0x0006;
/// Number of the text for all errors, in the description of this drive.
const TEXT_DRIVE_ERROR: u16 = 0x0101;

/// The messages since power-up.
#[derive(Clone, Debug, Default)]
pub(crate) struct History {
    messages: [Vec<u8>; ROOM as usize],
    written: u32,
    acknowledged: u8,
    now_ms: u64,
}

impl History {
    /// A millisecond passes.
    pub(crate) fn step(&mut self) {
        self.now_ms += 1;
    }

    /// Adds a message about an emergency.
    pub(crate) fn add(&mut self, error_code: u16) {
        let code = CODE_EMERGENCY | u32::from(error_code) << 16;
        let time_ns = 1_000_000 * self.now_ms;
        let mut message = code.to_le_bytes().to_vec();
        message.extend(FLAGS_ERROR.to_le_bytes());
        message.extend(TEXT_DRIVE_ERROR.to_le_bytes());
        message.extend(time_ns.to_le_bytes());
        message.extend(PARAMETER_WORD.to_le_bytes());
        message.extend(error_code.to_le_bytes());
        let place = self.written % u32::from(ROOM);
        if let Some(target) = self.messages.get_mut(place as usize) {
            *target = message;
        }
        self.written += 1;
    }

    /// Sub-index of the newest message; 0 before the first.
    fn newest(&self) -> u8 {
        match self.written.checked_sub(1) {
            Some(last) => FIRST + (last % u32::from(ROOM)) as u8,
            None => 0,
        }
    }

    /// A number of the history.
    pub(crate) fn get(&self, sub: u8) -> Option<i64> {
        Some(match sub {
            2 => self.newest().into(),
            3 => self.acknowledged.into(),
            4 => i64::from(self.newest() != self.acknowledged),
            _ => return None,
        })
    }

    /// A message; empty where there is none yet.
    pub(crate) fn message(&self, sub: u8) -> Option<&[u8]> {
        let place = sub.checked_sub(FIRST)?;
        self.messages.get(usize::from(place)).map(Vec::as_slice)
    }

    /// Acknowledges the messages up to the one at this sub-index; false if there is none.
    pub(crate) fn acknowledge(&mut self, sub: i64) -> bool {
        let exists = u8::try_from(sub).is_ok_and(|sub| self.message(sub).is_some_and(|message| !message.is_empty()));
        if exists {
            self.acknowledged = sub as u8;
        }
        exists
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ninth_message_takes_the_place_of_the_first_and_the_newest_is_told() {
        let mut history = History::default();
        assert_eq!((history.newest(), history.get(4)), (0, Some(0)));
        assert!(!history.acknowledge(i64::from(FIRST)));
        for number in 1..=19 {
            history.step();
            history.add(number);
            let place = FIRST + ((number - 1) % 8) as u8;
            assert_eq!(
                (history.newest(), history.get(2)),
                (place, Some(place.into())),
                "{number}"
            );
            let message = history.message(place).unwrap();
            assert_eq!(message[2..4], number.to_le_bytes());
            assert_eq!(message[8..16], (1_000_000 * u64::from(number)).to_le_bytes());
        }
        let errors: Vec<u8> = (FIRST..FIRST + ROOM)
            .map(|sub| history.message(sub).unwrap()[2])
            .collect();
        assert_eq!(errors, [17, 18, 19, 12, 13, 14, 15, 16]);
        assert_eq!(history.message(FIRST + ROOM), None);
        assert_eq!(history.get(4), Some(1));
        assert!(history.acknowledge(history.newest().into()) && history.get(4) == Some(0));
        for nothing in [-1, 0, 5, 14, 255, 1_000] {
            assert!(!history.acknowledge(nothing), "{nothing}");
        }
    }
}
