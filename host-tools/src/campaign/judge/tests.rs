use super::super::trouble;
use super::*;
use etherpen::ethercat::cyclic::ExchangeKind;
use etherpen::ethercat::state::AlState;

fn fault(words: &str) -> Fault {
    words.parse().expect("words of the script")
}

#[test]
fn what_was_put_right_is_judged_as_sound_again() {
    let config = Config::default();
    for words in [
        "cut 2",
        "remove 3",
        "swap 2 cia402",
        "swap 2 ax2000",
        "sii 1 blank",
        "refuse 1 op 0x001A",
        "recable 3 2",
        "mute 400",
        "deaf 4 400",
        "slip 2 10 50",
    ] {
        let mut judge = Judge::new(&config);
        for words in [Some(words.to_owned()), trouble::end(words)].into_iter().flatten() {
            judge.injected(fault(&words), 1, 1_000);
        }
        judge.end_disturbances(1_000 + AFTER_REPAIR_MS + 1);
        let left = (judge.disturbances, judge.untrue, judge.open.len());
        assert_eq!(left, (0, [0; AXES], 0), "{words}");
        assert_eq!(judge.asks_for_homing(), words.starts_with("slip"), "{words}");
        judge.reached(&Command::Home);
        judge.answered(&Command::Home, true);
        assert!(!judge.asks_for_homing());
    }

    let mut judge = Judge::new(&config);
    judge.injected(fault("remove 3"), 1, 1_000);
    judge.end_disturbances(1_000_000);
    assert_eq!(judge.disturbances, 1, "it is still missing");
}

/// The inputs of the monitor that tell of the second axis's feedback, since the last call.
fn told(judge: &mut Judge) -> Vec<Input> {
    let of_axis = |input: &Input| matches!(input, Input::Feedback { axis: 1, .. } | Input::Mounted { axis: 1 });
    judge.inputs.drain(..).filter(of_axis).collect()
}

#[test]
fn a_mounted_encoder_is_true_and_its_reference_once_the_robot_is_homed() {
    let mut judge = Judge::new(&Config::default());
    let home = |judge: &mut Judge| {
        judge.reached(&Command::Home);
        judge.answered(&Command::Home, true);
    };
    let untrue = Input::Feedback {
        axis: 1,
        disturbed: true,
    };
    let mounted = Input::Mounted { axis: 1 };
    for words in ["slip 2 10 50", "stuck 2 0"] {
        judge.injected(fault(words), 1, 1_000);
    }
    assert_eq!(told(&mut judge), [untrue, mounted]);
    assert!(judge.asks_for_homing());
    // Nobody homes by an encoder that slips.
    judge.injected(fault("slip 2 10 50"), 1, 2_000);
    assert!(!judge.asks_for_homing());
    home(&mut judge);
    judge.injected(fault("stuck 2 0"), 1, 3_000);
    assert_eq!(told(&mut judge), [untrue, mounted]);
    assert!(judge.asks_for_homing());
    home(&mut judge);
    assert!(!judge.asks_for_homing());
    // What passes ends by itself, but a robot that was homed meanwhile has an untrue reference.
    for homes in [false, true] {
        judge.injected(fault("stuck 2 20"), 1, 4_000);
        if homes {
            home(&mut judge);
        }
        judge.end_disturbances(5_000);
        let sound = Input::Feedback {
            axis: 1,
            disturbed: false,
        };
        assert_eq!(told(&mut judge), [untrue, sound]);
        assert_eq!(judge.asks_for_homing(), homes);
    }
}

#[test]
fn a_search_shows_nothing_about_an_encoder_that_is_mounted_while_it_goes_on() {
    for (mounted_in_search, answer_lost) in [(false, false), (true, false), (true, true), (false, true)] {
        let mut judge = Judge::new(&Config::default());
        judge.has_switches = true;
        judge.injected(fault("slip 2 10 50"), 1, 4_000);
        if !mounted_in_search {
            judge.injected(fault("stuck 2 0"), 1, 4_500);
        }
        judge.reached(&Command::Home);
        if !answer_lost {
            judge.answered(&Command::Home, true);
        }
        if mounted_in_search {
            judge.injected(fault("stuck 2 0"), 1, 5_000);
        }
        // Another order is refused meanwhile, perhaps before the mode is told.
        judge.reached(&Command::Home);
        judge.answered(&Command::Home, false);
        judge.in_mode(Mode::Homing, false);
        judge.in_mode(Mode::Idle, true);
        assert_eq!(judge.asks_for_homing(), mounted_in_search || answer_lost);
    }
}

/// A machine before a fault.
#[derive(Clone, Copy)]
struct Before {
    mode: Mode,
    /// For how long nothing was disturbed, ms.
    calm_ms: u64,
    is_homed: bool,
    /// State of the last slave.
    al_state: AlState,
    exchange: ExchangeKind,
    command: Option<Command>,
    is_serviced: bool,
}

const CALM: Before = Before {
    mode: Mode::DrivesOff,
    calm_ms: 1_001,
    is_homed: true,
    al_state: AlState::Operational,
    exchange: ExchangeKind::Split,
    command: None,
    is_serviced: false,
};

/// Whether the controller has to report a fault.
fn is_noticeable(words: &str, before: Before) -> bool {
    let mut config = Config::default();
    config.bus.exchange = before.exchange;
    let chain = Chain::new(&config);
    let mut notices = Notices::new(&config, &chain);
    let status = crate::console::status::tests::status(before.mode, None);
    let mut slaves: heapless::Vec<_, _> = (0..chain.slaves).map(|_| status.slaves[0].clone()).collect();
    slaves.last_mut().expect("drives").al_state = before.al_state as u8;
    let status = Status {
        referenced: before.is_homed,
        slaves,
        ..status
    };
    notices.reported(&status, &chain);
    for ms in 0..=before.calm_ms {
        notices.step(ms, false, false, before.mode == Mode::Idle);
    }
    if let Some(command) = &before.command {
        notices.commanded(command);
    }
    if before.is_serviced {
        notices.serviced();
    }
    notices.of(fault(words), before.calm_ms, &chain).is_some()
}

const IDLE: Before = Before {
    mode: Mode::Idle,
    ..CALM
};

#[test]
fn only_what_nothing_else_disturbs_has_to_be_noticed() {
    let noticed = [
        (
            CALM,
            ["pdi 2 900", "jump 3 100000", "power 1 900", "remove 4"].as_slice(),
        ),
        (
            IDLE,
            ["pdi 2 900", "mute 400", "deaf 2 400", "power 1 900", "remove 4"].as_slice(),
        ),
    ];
    for (machine, faults) in noticed {
        for words in faults {
            assert!(is_noticeable(words, machine), "{words}, {:?}", machine.mode);
            let disturbed = Before {
                calm_ms: 100,
                ..machine
            };
            assert!(!is_noticeable(words, disturbed), "{words}: just disturbed");
            let left = Before {
                al_state: AlState::SafeOperational,
                ..machine
            };
            assert!(!is_noticeable(words, left), "{words}: a drive has left OP");
            let ordered = Before {
                command: Some(Command::Home),
                ..machine
            };
            assert!(!is_noticeable(words, ordered), "{words}: a new home is ordered");
        }
    }
    for words in [
        "pdi 2 400",
        "jump 3 100",
        "power 1 90",
        "mute 400",
        "deaf 2 400",
        "drop",
    ] {
        assert!(!is_noticeable(words, CALM), "{words}");
    }
    for words in ["pdi 2 400", "jump 3 100000", "mute 6", "deaf 2 6"] {
        assert!(!is_noticeable(words, IDLE), "{words}");
    }
}

#[test]
fn what_the_machine_cannot_tell_need_not_be_noticed() {
    let unhomed = Before {
        is_homed: false,
        ..CALM
    };
    assert!(is_noticeable("pdi 2 900", unhomed));
    assert!(!is_noticeable("jump 3 100000", unhomed), "nothing is known");
    let combined = Before {
        exchange: ExchangeKind::Combined,
        ..IDLE
    };
    assert!(!is_noticeable("mute 400", combined), "no frame carries outputs alone");
    assert!(is_noticeable("deaf 2 400", combined));
    let serviced = Before {
        is_serviced: true,
        ..CALM
    };
    assert!(
        !is_noticeable("pdi 2 900", serviced),
        "the supervision waits for a service"
    );
    assert!(is_noticeable("power 1 900", serviced));
}

#[test]
fn a_path_is_told_with_each_order_until_one_behind_it_is_accepted() {
    let mut judge = Judge::new(&Config::default());
    let order = Command::Draw { job: 1 };
    let path = [PathVertex {
        position_um: [1_000, 2_000, 3_000],
        pen: Pen::Down,
        stroke: 1,
    }];
    let told = |judge: &mut Judge| {
        judge.reached(&order);
        let inputs = judge.inputs.drain(..);
        inputs.filter(|input| matches!(input, Input::PathVertex { .. })).count()
    };
    assert_eq!(told(&mut judge), 0, "an order beside the session");
    judge.orders(1, &path);
    judge.answered(&order, true);
    assert_eq!(told(&mut judge), 1, "the earlier order was accepted");
    judge.answered(&order, false);
    assert_eq!(told(&mut judge), 1, "it was refused");
    judge.answered(&order, true);
    assert_eq!(told(&mut judge), 0, "the session draws it");
}
