//! ethercrab brings a segment to OP that is at the other end of standard input and output.
//!
//! Each frame goes out with its length in front, two bytes, little-endian, and the reply comes back the same way.

use benchmarks::ethercrab_master::{Storage, bring_up_over};
use std::io::{Read, Write};

static STORAGE: Storage = Storage::new();

fn main() {
    let (mut input, mut output) = (std::io::stdin().lock(), std::io::stdout().lock());
    let drives = bring_up_over(&STORAGE, |frame| {
        let length = (frame.len() as u16).to_le_bytes();
        let sent = output
            .write_all(&[&length, &*frame].concat())
            .and_then(|()| output.flush());
        sent.expect("the segment takes frames");
        let mut length = [0; 2];
        input.read_exact(&mut length).expect("the segment answers");
        assert_eq!(
            usize::from(u16::from_le_bytes(length)),
            frame.len(),
            "a reply is as long as its frame"
        );
        input.read_exact(frame).expect("the reply is whole");
    });
    eprintln!("{drives} drives in OP");
}
