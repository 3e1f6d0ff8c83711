//! An image of no master, to be weighed and not to be run.
#![no_std]
#![no_main]

#[path = "image/mod.rs"]
mod image;

use cortex_m_rt::entry;

#[entry]
fn main() -> ! {
    let mut frame = [0; 1514];
    loop {
        image::wire(&mut frame);
    }
}
