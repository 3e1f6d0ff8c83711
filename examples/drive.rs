//! One CiA 402 drive without a robot: power on, one turn of the motor in each direction, power off. A drive that is
//! lost meanwhile is recovered and goes on. **Set the numbers in `drive` first**: with others the motor turns faster or slower.
//!
//! Emulated board: `cargo build --release -p etherpen --target thumbv7em-none-eabihf --no-default-features --features
//! emulated --example drive`. Linux: `cargo run --example drive -- eth1`.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg_attr(target_os = "none", path = "platform/emulated.rs")]
#[cfg_attr(not(target_os = "none"), path = "platform/linux.rs")]
mod platform;

use core::pin::pin;
use core::task::{Context, Waker};
use etherpen_drives::cia402::{DriveState, DriveTarget};
use etherpen_drives::io::{IoGroup, IoTrigger, VelocityIo};
use etherpen_drives::{AxisLimits, DriveSettings, EtherCatGroup, ServoAxis, ServoDrives};
use etherpen_ethercat::BusQueues;
use etherpen_ethercat::cyclic::{Arrival, Exchange, ExchangeKind};
use etherpen_ethercat::event::{BusCommand, BusEvent, BusSetup};
use etherpen_ethercat::supervisor::Supervisor;
use platform::{ADDRESS, Platform};

/// Up to eight slaves, one of them a drive, and mailboxes of up to 1,024 bytes.
type Queues = BusQueues<ServoDrives<1>, 8, 1024>;

const LIMITS: AxisLimits = AxisLimits {
    velocity_rad_s: 10.0,
    torque_nm: 0.0,
};
// Speed of the turns, rad/s, and their length, ms.
const SPEED_RAD_S: f64 = core::f64::consts::TAU;
const TURN_MS: u32 = 1_000;

fn run(platform: &mut Platform) {
    let mut queues = Queues::new();
    let (exchange, supervisor, mut application) = queues.split();
    let mut group = EtherCatGroup::new(Exchange::new(exchange, ADDRESS));
    let mut supervisor = Supervisor::new(supervisor).with_clock(Platform::now_ms);
    let mut supervision = pin!(supervisor.run());
    // Of the virtual drive. Digits of the target velocity (60FFh).
    let drive = DriveSettings {
        increments_per_revolution: 1 << 20,
        digits_per_rpm: 262_144.0 / 1_875.0,
        gear: 1.0,
        ..DriveSettings::default()
    };
    let setup = BusSetup {
        members: 1,
        settings: [drive],
        exchange: ExchangeKind::Combined,
        watchdog_ms: 100,
        ..BusSetup::default()
    };
    // The queue is empty: there is room.
    let _ = application.commands.enqueue(BusCommand::Start(setup));
    let (mut axis, mut on_ms, mut ends) = (ServoAxis::new(), 0, false);
    loop {
        platform.tick();
        platform.send(group.trigger_input());
        platform.receive(|frame| group.arrived(frame) == Arrival::Input);
        if group.renew() {
            axis.adopt(group.drive(0).as_ref(), &drive, &LIMITS);
        }
        let input = group.read(0);
        if let Some(input) = &input {
            axis.take(input);
            on_ms += u32::from(axis.state() == DriveState::OperationEnabled);
        }
        let (target, speed_rad_s) = match on_ms / TURN_MS {
            0 => (DriveTarget::Enabled, SPEED_RAD_S),
            1 => (DriveTarget::Enabled, -SPEED_RAD_S),
            2 => (DriveTarget::Enabled, 0.0),
            _ => (DriveTarget::Off, 0.0),
        };
        let has_power = input.is_some() && axis.state() == DriveState::OperationEnabled;
        if target == DriveTarget::Off && !has_power && !ends {
            ends = application.commands.enqueue(BusCommand::Stop).is_ok();
        }
        group.write(0, &axis.set_velocity(target, speed_rad_s));
        let _ = supervision.as_mut().poll(&mut Context::from_waker(Waker::noop()));
        while let Some(event) = application.events.dequeue() {
            use BusEvent::{Operational, Refused, Returned, SlaveLeft, SlaveLost, Stopped};
            match event {
                Operational => platform.say(format_args!("operational")),
                Stopped => return,
                SlaveLost { .. } | SlaveLeft { .. } | Returned { .. } | Refused { .. } if !ends => {
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
