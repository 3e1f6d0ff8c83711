//! An EK1100 with an EL1008 and an EL2004: each output of the EL2004 follows the input of the same number.
//!
//! Emulated board: `cargo build --release -p etherpen --target thumbv7em-none-eabihf --no-default-features --features
//! emulated --example terminals`. Linux: `cargo run --example terminals -- eth1`.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg_attr(target_os = "none", path = "platform/emulated.rs")]
#[cfg_attr(not(target_os = "none"), path = "platform/linux.rs")]
mod platform;

use core::pin::pin;
use core::task::{Context, Waker};
use etherpen_ethercat::BusQueues;
use etherpen_ethercat::cyclic::{Arrival, Exchange, ExchangeKind};
use etherpen_ethercat::driver::Direction;
use etherpen_ethercat::event::{BusCommand, BusEvent, BusSetup};
use etherpen_ethercat::no_drivers::NoDrivers;
use etherpen_ethercat::place::Place;
use etherpen_ethercat::slave_set::SlaveSet;
use etherpen_ethercat::supervisor::Supervisor;
use platform::{ADDRESS, Platform};

/// Up to eight slaves without drivers of their own, and mailboxes of up to 128 bytes.
type Queues = BusQueues<NoDrivers, 8, 128>;

/// Places in the chain.
const INPUTS: usize = 1;
const OUTPUTS: usize = 2;

fn run(platform: &mut Platform) {
    let mut queues = Queues::new();
    let (exchange, supervisor, mut application) = queues.split();
    let mut exchange = Exchange::new(exchange, ADDRESS);
    let mut supervisor = Supervisor::new(supervisor).with_clock(Platform::now_ms);
    let mut supervision = pin!(supervisor.run());
    let setup = BusSetup {
        slaves: 3,
        terminals: SlaveSet::ALL,
        exchange: ExchangeKind::Combined,
        watchdog_ms: 100,
        ..BusSetup::default()
    };
    // The queue is empty: there is room.
    let _ = application.commands.enqueue(BusCommand::Start(setup));
    let mut places: Option<(Place<u8>, Place<u8>)> = None;
    loop {
        platform.tick();
        platform.send(exchange.input_telegram());
        platform.receive(|frame| exchange.receive(frame) == Arrival::Input);
        // A new plan has new places: a slave came or went.
        if places.is_none_or(|(inputs, _)| inputs.plan() != exchange.plan_number()) {
            let inputs = exchange.bits(INPUTS, Direction::Inputs, 0, 4);
            places = inputs.zip(exchange.bits(OUTPUTS, Direction::Outputs, 0, 4));
        }
        if let Some((inputs, outputs)) = places {
            let value = exchange.get(&inputs).unwrap_or(0);
            exchange.set(&outputs, value);
        }
        let _ = supervision.as_mut().poll(&mut Context::from_waker(Waker::noop()));
        while let Some(event) = application.events.dequeue() {
            match event {
                BusEvent::Operational => platform.say(format_args!("operational")),
                BusEvent::SlaveLost { .. }
                | BusEvent::SlaveLeft { .. }
                | BusEvent::Returned { .. }
                | BusEvent::Refused { .. } => {
                    platform.say(format_args!("{event:?}, once more"));
                    let _ = application.commands.enqueue(BusCommand::Recover);
                }
                _ => {}
            }
        }
    }
}

#[cfg(not(target_os = "none"))]
fn main() -> std::process::ExitCode {
    platform::start()
}
