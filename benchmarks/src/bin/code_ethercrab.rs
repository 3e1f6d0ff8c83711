//! An image of ethercrab, to be weighed and not to be run.
#![no_std]
#![no_main]

#[path = "image/mod.rs"]
mod image;

use benchmarks::ethercrab_master::{self, Storage};
use cortex_m_rt::entry;

#[entry]
fn main() -> ! {
    static STORAGE: Storage = Storage::new();
    ethercrab_master::serve(&STORAGE, image::wire)
}
