//! Every way through the modes, against a plant that does what is requested.

use super::*;
use crate::motion::Pen;
use crate::robots::Position;

/// Drives that take and lose their power after 20 ms and stop within 30 ms.
struct Plant {
    application: Application,
    condition: Condition,
    progress: Progress,
    power: Power,
    power_since_ms: u32,
    now_ms: u32,
    silence_ms: u32,
    /// Whether a drive's fault can be reset.
    resets: bool,
    actions: std::vec::Vec<Action>,
}

impl Plant {
    fn new() -> Self {
        let condition = Condition {
            standstill: true,
            silent: None,
            ..Condition::UNKNOWN
        };
        Self {
            application: Application::new(),
            condition,
            progress: Progress {
                idle: true,
                ..Progress::default()
            },
            power: Power::Off,
            power_since_ms: 0,
            now_ms: 0,
            silence_ms: 0,
            resets: true,
            actions: std::vec::Vec::new(),
        }
    }

    fn run(&mut self, duration_ms: u32) {
        for _ in 0..duration_ms {
            self.now_ms += 1;
            let settled = self.now_ms - self.power_since_ms >= 20;
            match self.power {
                Power::On if settled && self.condition.drive_fault.is_none() => {
                    (self.condition.powered, self.condition.unpowered) = (true, false);
                }
                Power::QuickStop | Power::PathStop => {
                    self.condition.powered = false;
                    self.condition.standstill = self.now_ms - self.power_since_ms >= 30;
                }
                Power::Off if settled => (self.condition.powered, self.condition.unpowered) = (false, true),
                Power::FaultReset if self.resets => self.condition.drive_fault = None,
                _ => {}
            }
            for action in self
                .application
                .step(self.now_ms, &self.condition, self.progress, self.silence_ms)
            {
                self.take(action);
            }
        }
    }

    fn take(&mut self, action: Action) {
        match action {
            Action::Power(power) if power != self.power => (self.power, self.power_since_ms) = (power, self.now_ms),
            Action::Home { .. } => self.condition.unreferenced = None,
            Action::ClearFault => self.condition.fault = None,
            Action::RecoverBus if self.condition.silent.is_none() => self.application.bus(BusCondition::Operational),
            _ => {}
        }
        self.actions.push(action);
    }

    fn order(&mut self, command: Command) -> Result<(), Refusal> {
        let result = self.application.command(command);
        self.run(1);
        result
    }

    fn bus_up() -> Self {
        let mut plant = Self::new();
        plant.application.configured(500, false);
        assert_eq!(plant.application.mode(), Mode::BusConfiguring);
        plant.application.bus(BusCondition::Operational);
        plant.run(1);
        plant
    }

    fn idle() -> Self {
        let mut plant = Self::bus_up();
        plant.order(Command::Home).unwrap();
        plant.run(10);
        plant.order(Command::Enable).unwrap();
        plant.run(50);
        assert_eq!(plant.application.mode(), Mode::Idle);
        plant
    }

    fn drawing() -> Self {
        let mut plant = Self::idle();
        plant.order(Command::Draw { job: 1 }).unwrap();
        plant.progress.idle = false;
        plant.condition.standstill = false;
        plant.run(100);
        assert_eq!(plant.application.mode(), Mode::Drawing);
        plant
    }

    fn mode(&self) -> Mode {
        self.application.mode()
    }
}

#[test]
fn the_way_up_is_startup_bus_drives_off_idle() {
    let mut plant = Plant::new();
    assert_eq!(plant.mode(), Mode::Startup);
    assert_eq!(plant.order(Command::Enable), Err(Refusal::NotConfigured));
    plant = Plant::bus_up();
    assert_eq!(plant.mode(), Mode::DrivesOff);
    plant = Plant::idle();
    assert_eq!(plant.mode(), Mode::Idle);
}

#[test]
fn enabling_before_homing_holds_the_pose_and_draws_nothing() {
    let mut plant = Plant::bus_up();
    plant.order(Command::Enable).unwrap();
    plant.run(50);
    assert_eq!(plant.mode(), Mode::Unreferenced);
    assert_eq!(plant.order(Command::Draw { job: 1 }), Err(Refusal::NotReferenced));
    plant.order(Command::Home).unwrap();
    plant.run(10);
    assert_eq!(plant.mode(), Mode::Idle);
}

#[test]
fn homing_under_power_restarts_the_setpoints() {
    let mut plant = Plant::bus_up();
    plant.order(Command::Enable).unwrap();
    plant.run(50);
    plant.actions.clear();
    plant.order(Command::Home).unwrap();
    plant.run(10);
    let epochs = plant
        .actions
        .iter()
        .filter(|action| matches!(action, Action::Follow { .. }));
    assert_eq!(epochs.count(), 1);
}

#[test]
fn a_homing_that_is_not_taken_is_waited_for_as_long_as_the_power() {
    let mut plant = Plant::bus_up();
    plant.order(Command::Enable).unwrap();
    plant.run(50);
    assert_eq!(plant.mode(), Mode::Unreferenced);
    let asked_ms = plant.now_ms;
    plant.application.command(Command::Home).unwrap();
    for waited_ms in 1..=ENABLE_MAX_MS + 1 {
        plant.actions.clear();
        plant.run(1);
        assert_eq!(plant.now_ms - asked_ms, waited_ms);
        plant.condition.unreferenced = Some(0);
        let holds_again = plant
            .actions
            .iter()
            .any(|action| matches!(action, Action::Follow { .. }));
        assert_eq!(holds_again, waited_ms > ENABLE_MAX_MS, "after {waited_ms} ms");
        assert_eq!(plant.mode(), Mode::Unreferenced);
    }
    // Homing may be asked for again.
    assert_eq!(plant.application.command(Command::Home), Ok(()));
}

#[test]
fn commands_the_mode_does_not_allow_change_nothing() {
    let mut plant = Plant::idle();
    let before = plant.actions.len();
    for command in [Command::Hold, Command::Resume, Command::Cancel, Command::Acknowledge] {
        assert_eq!(plant.order(command), Err(Refusal::NotInMode(Mode::Idle)));
    }
    assert_eq!(
        plant.order(Command::Override { percent: 9 }),
        Err(Refusal::OverrideRange(9))
    );
    let nan = Command::Jog {
        velocity_mm_s: [f32::NAN, 0.0, 0.0],
    };
    assert_eq!(plant.order(nan), Err(Refusal::NotFinite));
    assert_eq!((plant.mode(), plant.actions.len()), (Mode::Idle, before));
}

#[test]
fn a_drawing_ends_in_idle_when_the_path_is_executed() {
    let mut plant = Plant::drawing();
    plant.progress.idle = true;
    plant.run(10);
    assert_eq!(
        plant.mode(),
        Mode::Drawing,
        "the last setpoints are still being followed"
    );
    plant.condition.standstill = true;
    plant.run(FOLLOWED_MS - 11);
    assert_eq!(plant.mode(), Mode::Drawing, "the pen may rest before its last lift");
    plant.run(1);
    assert_eq!(plant.mode(), Mode::Idle);
}

#[test]
fn a_drawing_is_held_and_resumed() {
    let mut plant = Plant::drawing();
    plant.order(Command::Hold).unwrap();
    assert_eq!(plant.mode(), Mode::Holding);
    plant.progress.held = true;
    plant.run(2_000);
    assert_eq!(plant.mode(), Mode::Holding);
    plant.order(Command::Resume).unwrap();
    assert_eq!(plant.mode(), Mode::Drawing);
}

#[test]
fn a_silent_host_holds_the_drawing_and_only_resume_moves_again() {
    let mut plant = Plant::drawing();
    plant.silence_ms = 501;
    plant.run(1);
    assert_eq!(plant.mode(), Mode::Holding);
    assert!(plant.actions.contains(&Action::Motion(MotionCommand::Hold)));
    plant.silence_ms = 0;
    plant.run(5_000);
    assert_eq!(plant.mode(), Mode::Holding);
}

#[test]
fn cancel_stops_on_the_path_and_returns_to_idle() {
    let mut plant = Plant::drawing();
    plant.order(Command::Cancel).unwrap();
    assert_eq!(plant.mode(), Mode::Stopping);
    plant.run(100);
    assert_eq!(plant.mode(), Mode::Stopping);
    plant.progress.idle = true;
    plant.condition.standstill = true;
    plant.run(FOLLOWED_MS + 1);
    assert_eq!((plant.mode(), plant.power), (Mode::Idle, Power::On));
}

#[test]
fn leaving_power_is_ramp_standstill_brake_delay_off() {
    let mut plant = Plant::idle();
    plant.order(Command::Disable).unwrap();
    assert_eq!((plant.mode(), plant.power), (Mode::Stopping, Power::QuickStop));
    plant.run(BRAKE_DELAY_MS - 5);
    assert_eq!(plant.power, Power::QuickStop, "the brake is still closing");
    plant.run(60);
    assert_eq!((plant.mode(), plant.power), (Mode::DrivesOff, Power::Off));
}

#[test]
fn a_stop_is_a_latched_fault_that_is_acknowledged_and_recovered() {
    let mut plant = Plant::drawing();
    plant.order(Command::Stop).unwrap();
    assert_eq!((plant.mode(), plant.power), (Mode::Stopping, Power::PathStop));
    plant.run(500);
    assert_eq!((plant.mode(), plant.power), (Mode::Fault, Power::Off));
    assert_eq!(plant.application.fault(), Some(Fault::EmergencyStop(StopSource::Link)));
    assert_eq!(plant.order(Command::Enable), Err(Refusal::NotInMode(Mode::Fault)));
    plant.order(Command::Acknowledge).unwrap();
    plant.run(100);
    assert_eq!((plant.mode(), plant.application.fault()), (Mode::DrivesOff, None));
}

#[test]
fn a_drive_fault_is_reset_by_the_acknowledgement() {
    let mut plant = Plant::drawing();
    let fault = Fault::Drive {
        axis: 2,
        status_word: 0x0008,
    };
    plant.condition.fault = Some(fault);
    plant.condition.drive_fault = Some(fault);
    plant.run(1_000);
    assert_eq!((plant.mode(), plant.application.fault()), (Mode::Fault, Some(fault)));
    plant.order(Command::Acknowledge).unwrap();
    assert!(plant.actions.contains(&Action::Power(Power::FaultReset)));
    plant.run(100);
    assert_eq!(plant.mode(), Mode::DrivesOff);
}

#[test]
fn a_lost_slave_stays_a_fault_until_the_bus_is_well_again() {
    let mut plant = Plant::drawing();
    plant.condition.fault = Some(Fault::SlaveLost { slave: 1 });
    plant.condition.silent = Some(1);
    plant.run(1_000);
    let named = Fault::SlaveState {
        slave: 1,
        al_state: 0x14,
        al_code: 0x1b,
    };
    plant.application.bus(BusCondition::Failed(named));
    assert_eq!((plant.mode(), plant.application.fault()), (Mode::Fault, Some(named)));
    plant.order(Command::Acknowledge).unwrap();
    assert!(plant.actions.contains(&Action::RecoverBus));
    plant.run(1_000);
    assert_eq!(plant.mode(), Mode::Fault, "the slave is not back yet");
    plant.application.bus(BusCondition::Operational);
    plant.condition.silent = None;
    plant.run(100);
    assert_eq!(plant.mode(), Mode::DrivesOff);
}

#[test]
fn a_recovery_that_fails_names_what_is_still_wrong() {
    let unexpected = Fault::UnexpectedBus { found: 3, expected: 4 };
    let lost = Fault::SlaveLost { slave: 3 };
    let broken = || {
        let mut plant = Plant::bus_up();
        plant.condition.silent = Some(3);
        plant.application.bus(BusCondition::Failed(lost));
        plant.run(10);
        plant.order(Command::Acknowledge).unwrap();
        assert!(plant.application.is_recovering());
        assert_eq!(plant.order(Command::Acknowledge), Err(Refusal::Recovering));
        plant
    };
    let told = |plant: &Plant| {
        (
            plant.mode(),
            plant.application.fault(),
            plant.application.is_recovering(),
        )
    };
    // The supervisor has given up: at once.
    let mut plant = broken();
    plant.application.bus(BusCondition::Refused(unexpected));
    plant.run(1);
    assert_eq!(told(&plant), (Mode::Fault, Some(unexpected), false));
    assert!(plant.order(Command::Acknowledge).is_ok(), "it may be tried again");
    // The supervisor is silent.
    let mut plant = broken();
    plant.run(RECOVERY_MAX_MS + 100);
    let silence = Fault::RepairTimeout {
        waited_ms: RECOVERY_MAX_MS as u16,
    };
    assert_eq!(told(&plant), (Mode::Fault, Some(silence), false));
    // The bus is operational, but no position arrives.
    let mut plant = broken();
    plant.application.bus(BusCondition::Operational);
    plant.run(RECOVERY_MAX_MS + 100);
    assert_eq!(told(&plant), (Mode::Fault, Some(lost), false));
    // A drive's fault cannot be reset.
    let mut plant = broken();
    let drive = Fault::Drive {
        axis: 1,
        status_word: 8,
    };
    plant.application.bus(BusCondition::Operational);
    (plant.condition.silent, plant.condition.drive_fault, plant.resets) = (None, Some(drive), false);
    plant.run(RECOVERY_MAX_MS + 100);
    assert_eq!(told(&plant), (Mode::Fault, Some(drive), false));
    assert_eq!(plant.power, Power::Off, "nobody goes on resetting it");
}

#[test]
fn a_repair_that_waits_for_a_slow_slave_is_not_given_up_before_the_supervisor_ends_the_wait() {
    let mut plant = Plant::bus_up();
    plant.condition.silent = Some(3);
    plant
        .application
        .bus(BusCondition::Failed(Fault::SlaveLost { slave: 3 }));
    plant.run(10);
    plant.order(Command::Acknowledge).unwrap();
    for _ in 0..3 * RECOVERY_MAX_MS {
        plant.application.bus_waits();
        plant.run(1);
        assert!(plant.application.is_recovering());
    }
    plant.run(RECOVERY_MAX_MS - 100);
    assert!(
        plant.application.is_recovering(),
        "the limit begins with the end of the wait"
    );
    plant.run(200);
    assert!(!plant.application.is_recovering(), "and then it ends");
}

#[test]
fn a_motion_and_homing_in_one_millisecond_exclude_each_other() {
    let position = Position {
        x_mm: 0.0,
        y_mm: 0.0,
        z_mm: -800.0,
    };
    let motions = [
        Command::Move { position },
        Command::Pen { pen: Pen::Up },
        Command::Jog {
            velocity_mm_s: [1.0, 0.0, 0.0],
        },
        Command::Draw { job: 1 },
    ];
    for motion in motions {
        let mut plant = Plant::idle();
        plant.application.command(Command::Home).unwrap();
        assert_eq!(plant.application.command(motion), Err(Refusal::Moving), "{motion:?}");
        plant.run(10);
        plant.order(motion).unwrap();
        let mut plant = Plant::idle();
        plant.application.command(motion).unwrap();
        let now = Err(Refusal::NotInMode(plant.mode()));
        assert_eq!(plant.application.command(Command::Home), now, "{motion:?}");
    }
}

#[test]
fn drives_that_do_not_take_power_are_a_fault() {
    let mut plant = Plant::bus_up();
    plant.condition.drive_fault = Some(Fault::Drive {
        axis: 0,
        status_word: 8,
    });
    plant.order(Command::Enable).unwrap();
    plant.run(ENABLE_MAX_MS + 10);
    assert!(matches!(plant.application.fault(), Some(Fault::EnableTimeout { .. })));
}

#[test]
fn the_first_fault_is_kept_when_others_follow() {
    let mut plant = Plant::drawing();
    plant.order(Command::Stop).unwrap();
    plant.condition.fault = Some(Fault::SetpointUnderrun);
    plant.run(100);
    assert_eq!(plant.application.fault(), Some(Fault::EmergencyStop(StopSource::Link)));
}

#[test]
fn a_stop_that_left_its_path_replaces_the_order_of_the_stop_and_no_other_fault() {
    let left = Fault::PathStopLeft(PathStopFailure::Dry);
    let mut plant = Plant::drawing();
    plant.order(Command::Stop).unwrap();
    plant.condition.fault = Some(left);
    plant.run(100);
    assert_eq!(plant.application.fault(), Some(left));
    let drive = Fault::Drive {
        axis: 2,
        status_word: 0x0008,
    };
    let mut plant = Plant::drawing();
    plant.condition.fault = Some(drive);
    plant.run(10);
    plant.condition.fault = Some(left);
    plant.run(100);
    assert_eq!(plant.application.fault(), Some(drive));
}

#[test]
fn a_stop_keeps_the_path_until_the_bus_fails_and_every_fault_that_doubts_the_drives_is_a_quick_stop() {
    let drive = Fault::Drive {
        axis: 2,
        status_word: 0x0008,
    };
    let late = Fault::CyclesLate { late: 11, limit: 10 };
    for (fault, expected) in [
        (drive, Power::QuickStop),
        (Fault::EmergencyStop(StopSource::Input), Power::QuickStop),
        (Fault::SetpointUnderrun, Power::QuickStop),
        (late, Power::PathStop),
    ] {
        let mut plant = Plant::drawing();
        plant.condition.fault = Some(fault);
        plant.run(1);
        assert_eq!((plant.mode(), plant.power), (Mode::Stopping, expected), "{fault:?}");
    }
    let mut plant = Plant::drawing();
    plant.order(Command::Stop).unwrap();
    plant.order(Command::Stop).unwrap();
    assert_eq!(plant.power, Power::PathStop);
    let lost = Fault::SlaveLost { slave: 1 };
    plant.application.bus(BusCondition::Failed(lost));
    for action in plant.application.take_actions() {
        plant.take(action);
    }
    assert_eq!((plant.mode(), plant.power), (Mode::Stopping, Power::QuickStop));
}

#[test]
fn moves_and_jogs_return_to_idle_when_the_trajectory_rests() {
    let mut plant = Plant::idle();
    plant.order(Command::Pen { pen: Pen::Up }).unwrap();
    assert_eq!(plant.mode(), Mode::Moving);
    plant.run(FOLLOWED_MS + 1);
    assert_eq!(plant.mode(), Mode::Idle);
    let position = Position {
        x_mm: 0.0,
        y_mm: 0.0,
        z_mm: -800.0,
    };
    plant.order(Command::Move { position }).unwrap();
    assert_eq!(
        plant.order(Command::Move { position }),
        Err(Refusal::NotInMode(Mode::Moving))
    );
}

#[test]
fn another_configuration_is_taken_only_without_power() {
    assert!(Plant::bus_up().application.may_configure());
    assert!(!Plant::idle().application.may_configure());
    assert!(!Plant::drawing().application.may_configure());
}

#[test]
fn the_first_lost_slave_is_the_cause_and_those_behind_it_are_not() {
    let mut plant = Plant::drawing();
    plant.condition.fault = Some(Fault::Blind {
        blind_ms: 6,
        limit_ms: 5,
    });
    plant.run(10);
    for slave in [1, 2, 3] {
        plant.application.bus(BusCondition::Failed(Fault::SlaveLost { slave }));
    }
    let consequence = Fault::SlaveState {
        slave: 3,
        al_state: 0x14,
        al_code: 0x1b,
    };
    plant.application.bus(BusCondition::Failed(consequence));
    assert_eq!(plant.application.fault(), Some(Fault::SlaveLost { slave: 1 }));
}

#[test]
fn a_motion_without_progress_is_a_fault_with_its_place_and_is_acknowledged() {
    let mut plant = Plant::idle();
    plant.application.command(Command::Draw { job: 1 }).unwrap();
    plant.progress = Progress {
        stalled_ms: 2_004,
        executed: 17,
        ..Progress::default()
    };
    plant.run(1);
    let fault = Fault::MotionStalled {
        vertex: 17,
        waited_ms: 2_004,
    };
    assert_eq!(plant.application.fault(), Some(fault));
    assert!(plant.actions.contains(&Action::Power(Power::PathStop)));
    plant.progress = Progress {
        idle: true,
        ..Progress::default()
    };
    plant.run(1_000);
    assert_eq!(plant.application.mode(), Mode::Fault);
    plant.application.command(Command::Acknowledge).unwrap();
    plant.run(1_000);
    assert_eq!(
        (plant.application.mode(), plant.application.fault()),
        (Mode::DrivesOff, None)
    );
}
