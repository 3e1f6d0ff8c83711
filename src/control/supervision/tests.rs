use super::*;
use crate::application::PathStopFailure;

fn well() -> Observation {
    Observation {
        valid: [true; AXES],
        unconfirmed: 0,
        following_error_rad: [0.0; AXES],
        output_rad_s: [0.0; AXES],
        status_word: [0x0637; AXES],
        drive_fault: [false; AXES],
        home_lost: [false; AXES],
        al_status: Some(AL_OPERATIONAL),
        clock: None,
        power: true,
        following: true,
        underrun: false,
        late: 0,
        interlock: None,
        io_stop: None,
        spares_terminals: false,
    }
}

fn run(cycles: usize, seen: &Observation) -> Option<Fault> {
    let mut supervision = Supervision::new();
    let (axes, bus) = ([Axis::default(); AXES], Bus::default());
    (0..cycles).find_map(|_| supervision.step(&axes, &bus, seen))
}

#[test]
fn a_healthy_bus_never_faults() {
    assert_eq!(run(10_000, &well()), None);
}

#[test]
fn blind_motion_lasts_for_the_configured_limit_and_no_longer() {
    let blind = Observation {
        valid: [false; AXES],
        al_status: None,
        ..well()
    };
    let limit_ms = Bus::default().blind_max_ms;
    assert_eq!(run(usize::from(limit_ms), &blind), None);
    assert_eq!(
        run(usize::from(limit_ms) + 1, &blind),
        Some(Fault::Blind {
            blind_ms: limit_ms + 1,
            limit_ms
        })
    );
}

#[test]
fn gaps_that_end_in_time_do_not_add_up() {
    let mut supervision = Supervision::new();
    let (axes, bus) = ([Axis::default(); AXES], Bus::default());
    let blind = Observation {
        valid: [false; AXES],
        al_status: None,
        ..well()
    };
    for _ in 0..5 {
        for _ in 0..bus.blind_max_ms {
            assert_eq!(supervision.step(&axes, &bus, &blind), None);
        }
        assert_eq!(supervision.step(&axes, &bus, &well()), None);
    }
}

#[test]
fn a_lost_clock_stops_drives_that_have_power_and_no_others() {
    let fault = Fault::ClockLost {
        missing_cycles: 10,
        limit_cycles: 10,
    };
    let lost = Observation {
        clock: Some(fault),
        ..well()
    };
    assert_eq!(run(1, &lost), Some(fault));
    let off = Observation { power: false, ..lost };
    assert_eq!(run(100, &off), None);
}

#[test]
fn an_interlock_is_latched_with_or_without_power_and_again_after_it_was_cleared() {
    for power in [true, false] {
        let open = Observation {
            interlock: Some(Interlock::EmergencyStop),
            power,
            following: power,
            ..well()
        };
        let expected = Some(Interlock::EmergencyStop.fault());
        let mut supervision = Supervision::new();
        let (axes, bus) = ([Axis::default(); AXES], Bus::default());
        for _ in 0..3 {
            assert_eq!(supervision.step(&axes, &bus, &open), expected);
            supervision.clear();
        }
        assert_eq!(supervision.step(&axes, &bus, &well()), None);
    }
}

#[test]
fn one_silent_slave_is_named() {
    let lost = Observation {
        valid: [true, true, false, true],
        ..well()
    };
    assert_eq!(run(100, &lost), Some(Fault::SlaveLost { slave: 2 }));
}

#[test]
fn a_following_error_above_its_limit_names_axis_value_and_limit() {
    let far = Observation {
        following_error_rad: [0.0, -0.06, 0.0, 0.0],
        ..well()
    };
    let expected = Fault::FollowingError {
        axis: 1,
        error_rad: 0.06,
        limit_rad: 0.05,
    };
    assert_eq!(run(1, &far), Some(expected));
}

#[test]
fn a_position_that_is_not_a_number_stops_the_drives() {
    let broken = Observation {
        following_error_rad: [f64::NAN, 0.0, 0.0, 0.0],
        ..well()
    };
    assert!(matches!(run(1, &broken), Some(Fault::FollowingError { axis: 0, .. })));
}

#[test]
fn an_output_at_the_clamp_faults_after_a_few_cycles_only() {
    let high = Observation {
        output_rad_s: [0.0, 0.0, 0.0, 30.0],
        ..well()
    };
    assert_eq!(run(usize::from(CLAMPED_CYCLES_MAX) - 1, &high), None);
    assert!(matches!(
        run(usize::from(CLAMPED_CYCLES_MAX), &high),
        Some(Fault::OutputLimit { axis: 3, .. })
    ));
}

#[test]
fn more_late_cycles_than_configured_within_a_second_fault_when_something_moves() {
    let late = Observation { late: 1, ..well() };
    assert_eq!(run(10, &late), None);
    assert_eq!(run(11, &late), Some(Fault::CyclesLate { late: 11, limit: 10 }));
    assert_eq!(
        run(
            500,
            &Observation {
                following: false,
                ..late
            }
        ),
        None
    );
}

#[test]
fn late_cycles_of_two_seconds_are_not_counted_together() {
    let (axes, bus) = ([Axis::default(); AXES], Bus::default());
    let limit = usize::from(bus.late_max_per_s);
    let mut supervision = Supervision::new();
    let mut run = |cycles: usize, late: u16| {
        let seen = Observation { late, ..well() };
        (0..cycles).find_map(|_| supervision.step(&axes, &bus, &seen))
    };
    for _ in 0..3 {
        assert_eq!(run(limit, 1), None);
        assert_eq!(run(usize::from(LATE_WINDOW_MS) - limit, 0), None);
    }
    assert!(run(limit + 1, 1).is_some());
}

#[test]
fn the_first_cause_stays_until_it_is_cleared() {
    let mut supervision = Supervision::new();
    supervision.latch(Fault::SetpointUnderrun);
    supervision.latch(Fault::ReferenceLost { axis: 0 });
    assert_eq!(supervision.fault(), Some(Fault::SetpointUnderrun));
    supervision.clear();
    assert_eq!(supervision.fault(), None);
}

#[test]
fn the_failure_of_a_stop_replaces_what_ordered_the_stop_and_no_other_cause() {
    let left = Fault::PathStopLeft(PathStopFailure::Dry);
    for (first, expected) in [
        (Fault::CyclesLate { late: 11, limit: 10 }, left),
        (Fault::SetpointUnderrun, left),
        (Fault::ReferenceLost { axis: 1 }, Fault::ReferenceLost { axis: 1 }),
    ] {
        let mut supervision = Supervision::new();
        supervision.latch(first);
        supervision.latch(left);
        assert_eq!(supervision.fault(), Some(expected));
        assert!(supervision.stops_at_once());
    }
}

#[test]
fn nothing_that_moves_nothing_is_a_fault() {
    let idle = Observation {
        power: false,
        following: false,
        valid: [false; AXES],
        drive_fault: [true; AXES],
        ..well()
    };
    assert_eq!(run(100, &idle), None);
}

#[test]
fn a_stop_input_is_latched_with_power_and_an_open_emergency_stop_without_it_too() {
    use crate::application::InputCause::{Missing, Open};
    use crate::config::IoRole::{Door, EmergencyStop};
    for (role, cause, without_power) in [
        (EmergencyStop, Open, true),
        (EmergencyStop, Missing, false),
        (Door, Open, false),
        (Door, Missing, false),
    ] {
        let axis = u8::MAX;
        let stop = IoStop {
            io: 3,
            role,
            axis,
            cause,
        };
        let with = |power| Observation {
            io_stop: Some(stop),
            power,
            following: power,
            ..well()
        };
        assert_eq!(run(1, &with(true)), Some(stop.fault()), "{stop:?}");
        assert_eq!(run(100, &with(false)).is_some(), without_power, "{stop:?}");
    }
}

#[test]
fn an_unexpected_state_waits_for_its_name_only_where_terminals_are_spared() {
    let strange = Observation {
        al_status: Some(AL_OPERATIONAL | 0x14),
        ..well()
    };
    assert!(run(1, &strange).is_some());
    let spared = Observation {
        spares_terminals: true,
        ..strange
    };
    let most = usize::from(AL_UNEXPLAINED_MAX_MS);
    assert_eq!(run(most, &spared), None);
    assert!(run(most + 1, &spared).is_some());
    // What was explained in between starts afresh.
    let mut supervision = Supervision::new();
    let (axes, bus) = ([Axis::default(); AXES], Bus::default());
    for cycle in 0..10 * most {
        let seen = if cycle % most == 0 { well() } else { spared };
        assert_eq!(supervision.step(&axes, &bus, &seen), None, "cycle {cycle}");
    }
}

#[test]
fn outputs_that_no_drive_confirms_stop_the_robot_within_the_blind_limit_and_one_telegram_never_does() {
    let limit_ms = Bus::default().blind_max_ms;
    let deaf = |unconfirmed| Observation { unconfirmed, ..well() };
    for (unconfirmed, axis) in [(0b1111, None), (0b0100, Some(2))] {
        let seen = deaf(unconfirmed);
        assert_eq!(run(usize::from(limit_ms) - 1, &seen), None);
        let lost = Fault::OutputsLost {
            axis,
            lost_ms: limit_ms,
            limit_ms,
        };
        assert_eq!(run(limit_ms.into(), &seen), Some(lost));
        assert_eq!(run(1_000, &Observation { power: false, ..seen }), None);
    }
    let (axes, bus) = (
        [Axis::default(); AXES],
        Bus {
            blind_max_ms: 1,
            ..Bus::default()
        },
    );
    let mut supervision = Supervision::new();
    for _ in 0..100 {
        assert_eq!(supervision.step(&axes, &bus, &deaf(0b1111)), None);
        assert_eq!(supervision.step(&axes, &bus, &well()), None);
    }
    // Gaps of the inputs of one axis and the outputs of another do not add up.
    let mut supervision = Supervision::new();
    let bus = Bus::default();
    for _ in 0..100 {
        for _ in 0..limit_ms - 1 {
            assert_eq!(supervision.step(&axes, &bus, &deaf(0b0001)), None);
        }
        for _ in 0..limit_ms - 1 {
            assert_eq!(supervision.step(&axes, &bus, &deaf(0b0010)), None);
        }
    }
}
