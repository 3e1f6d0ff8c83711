//! Every fault of frames at every stage: bring-up, SAFEOP, OP, and during an SDO.

use crate::rig::{Rig, idle_rig, rig};
use etherpen::ethercat::cyclic::{BusCounters, IGNORED_KINDS, Ignored};
use etherpen::ethercat::diagnostics::{ServiceReply, ServiceRequest};
use etherpen::ethercat::error::BusError;
use etherpen::ethercat::state::AlState;
use etherpen::ethercat::supervisor::BusEvent;
use etherpen::ethercat::wire::coe::Object;
use etherpen::ethercat::wire::register;
use etherpen::robots::AXES;
use host_tools::cell::{self, Fault};

/// An object that keeps whatever is written to it.
const COMMENT: Object = Object::new(0x2FFE, 0);
/// Longest time from the start to OP with disturbances and new tries, ms.
const BRING_UP_MAX_MS: u32 = 20_000;
/// Pause before a new try, ms.
const RETRY_MS: u64 = 50;
/// How long OP has to last, ms.
const SETTLED_MS: u32 = 120;

/// What one fault of a telegram costs.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Cost {
    /// Nothing; something else is dropped in addition to the reply.
    Nothing(Ignored),
    /// The reply, which is never seen.
    Reply,
    /// The reply, which is dropped as this kind.
    Dropped(Ignored),
    /// The data of all slaves in the telegram, by their working counters.
    Data,
}

const KINDS: [(&str, Fault, Cost); 14] = [
    ("drop", Fault::Drop, Cost::Reply),
    ("lose", Fault::Lose, Cost::Reply),
    ("delay 2", Fault::Delay(2), Cost::Dropped(Ignored::Late)),
    ("duplicate", Fault::Duplicate, Cost::Nothing(Ignored::Duplicate)),
    ("truncate 20", Fault::Truncate(20), Cost::Dropped(Ignored::Truncated)),
    ("overlong 10", Fault::Overlong(10), Cost::Dropped(Ignored::Mismatch)),
    ("index 7", Fault::Index(7), Cost::Dropped(Ignored::ForeignIndex)),
    ("counter 1", Fault::Counter(1), Cost::Data),
    ("type 4", Fault::Type(4), Cost::Dropped(Ignored::FrameType)),
    ("more", Fault::More, Cost::Dropped(Ignored::Mismatch)),
    ("circulate", Fault::Circulate, Cost::Dropped(Ignored::Circulating)),
    ("vlan", Fault::Vlan, Cost::Dropped(Ignored::EtherType)),
    ("foreign", Fault::Foreign, Cost::Nothing(Ignored::EtherType)),
    ("reflect", Fault::Reflect, Cost::Nothing(Ignored::Reflection)),
];

/// Increase of the counters.
fn difference(after: &BusCounters, before: &BusCounters) -> ([u32; IGNORED_KINDS], u32, u32) {
    (
        std::array::from_fn(|kind| after.ignored[kind] - before.ignored[kind]),
        after.frames_lost - before.frames_lost,
        after.working_counter_errors - before.working_counter_errors,
    )
}

fn is_failure(event: &BusEvent) -> bool {
    matches!(
        event,
        BusEvent::Refused { .. } | BusEvent::SlaveLost { .. } | BusEvent::SlaveLeft { .. }
    )
}

/// Brings the bus up with as many tries as it takes; returns their number.
fn come_up(rig: &mut Rig<'_>) -> u32 {
    let (mut tries, mut from) = (1, rig.log.len());
    let mut retry_at_ms = None;
    for _ in 0..BRING_UP_MAX_MS {
        rig.millisecond();
        let failed = rig.log[from..].iter().any(is_failure);
        if failed && rig.now_ms >= *retry_at_ms.get_or_insert(rig.now_ms + RETRY_MS) {
            (retry_at_ms, from) = (None, rig.log.len());
            tries += 1;
            rig.recover();
        }
        if !failed && rig.log[from..].contains(&BusEvent::Operational) {
            // The effect of the last disturbance shows within this time.
            rig.run_ms(SETTLED_MS);
            if !rig.log[from..].iter().any(is_failure) {
                return tries;
            }
        }
    }
    panic!("not in OP: {:#?}", rig.log);
}

fn assert_well(rig: &Rig<'_>) {
    for slave in rig.cell.state().slaves {
        assert_eq!((slave.al_state, slave.al_status_code), (cell::AlState::Operational, 0));
    }
    assert!(rig.inputs.iter().all(Option::is_some));
}

/// The frames at which stages begin in an undisturbed bring-up, and some in between.
fn stages() -> Vec<(&'static str, u64)> {
    let mut rig = rig("");
    let mut stages = vec![("discovery", 1)];
    let reached = [
        ("PREOP of the first", 0, cell::AlState::PreOperational),
        ("SAFEOP of the first", 0, cell::AlState::SafeOperational),
        ("PREOP of the last", 3, cell::AlState::PreOperational),
        ("SAFEOP of the last", 3, cell::AlState::SafeOperational),
        ("OP of the first", 0, cell::AlState::Operational),
        ("OP of the last", 3, cell::AlState::Operational),
    ];
    let mut next = reached.iter().peekable();
    while !rig.millisecond().contains(&BusEvent::Operational) {
        let state = rig.cell.state();
        while let Some((name, _, _)) = next.next_if(|(_, slave, stage)| state.slaves[*slave].al_state >= *stage) {
            stages.push((name, state.frames));
        }
        assert!(rig.now_ms < 10_000);
    }
    assert_eq!(next.next(), None);
    let last = rig.cell.state().frames;
    stages.extend((1..8).map(|part| ("in between", last * part / 8)));
    stages
}

#[test]
pub(crate) fn a_few_disturbed_frames_at_any_stage_of_the_bring_up_delay_it_only() {
    let stages = stages();
    println!("{stages:?}");
    for (text, ..) in KINDS {
        for (stage, first) in &stages {
            let mut rig = rig(&format!("frame {first}..{} {text}", first + 2));
            assert_eq!(come_up(&mut rig), 1, "{text} at {stage}, frame {first}: {:#?}", rig.log);
            assert_well(&rig);
        }
    }
}

#[test]
pub(crate) fn many_disturbed_frames_at_any_stage_of_the_bring_up_are_survived_or_refused_and_the_next_try_succeeds() {
    let mut refused = 0;
    for (text, ..) in KINDS {
        for (stage, first) in stages() {
            let mut rig = rig(&format!("frame {first}..{} {text}", first + 39));
            let tries = come_up(&mut rig);
            refused += u32::from(tries > 1);
            assert!(
                tries <= 3,
                "{text} at {stage}, frame {first}: {tries} tries, {:#?}",
                rig.log
            );
            assert_well(&rig);
        }
    }
    println!("{refused} bring-ups were refused first");
}

#[test]
pub(crate) fn a_mailbox_message_lost_on_its_way_is_given_again_and_its_request_is_not_sent_again() {
    let undisturbed = {
        let mut rig = rig("");
        assert_eq!(come_up(&mut rig), 1);
        rig.mail
    };
    println!("undisturbed: {undisturbed:?}");
    assert!(undisturbed.answers >= 20 && undisturbed.repeats == 0);
    for lost in 1..=undisturbed.answers {
        let mut rig = rig("");
        rig.mail.lost = lost;
        assert_eq!(come_up(&mut rig), 1, "message {lost}: {:#?}", rig.log);
        assert_well(&rig);
        let (seen, expected) = (rig.mail, undisturbed);
        assert_eq!(
            seen.requests, expected.requests,
            "message {lost}: no request is sent again"
        );
        assert_eq!(
            (seen.answers, seen.repeats),
            (expected.answers + 1, 1),
            "message {lost} is asked for once and given once more"
        );
    }
}

#[test]
pub(crate) fn a_message_that_a_slave_cannot_give_again_is_a_timeout_and_the_next_try_succeeds() {
    let script: String = (1..=AXES)
        .map(|slave| format!("ms 1 processor {slave} repeat ignored\n"))
        .collect();
    for lost in [1, 25, 58] {
        let mut rig = rig(&script);
        rig.mail.lost = lost;
        rig.wait_for(10_000, |event| {
            matches!(event, BusEvent::Refused { position: Some(_), error: BusError::MailboxTimeout { waited_ms }, .. }
                if *waited_ms > 1_000)
        });
        rig.recover();
        rig.operational();
        rig.run_ms(SETTLED_MS);
        assert_well(&rig);
    }
}

#[test]
pub(crate) fn a_frame_fault_in_op_costs_one_cycle_of_its_telegram_and_nothing_else() {
    let mut rig = rig("");
    rig.operational();
    rig.run_ms(50);
    let events = rig.log.len();
    for (text, fault, cost) in KINDS {
        for of_inputs in [true, false] {
            let before = rig.counters();
            match of_inputs {
                true => rig.cell.inject(fault),
                false => rig.output_fault = Some(fault),
            }
            let mut missing = [0; AXES];
            for _ in 0..60 {
                rig.millisecond();
                for (missing, input) in missing.iter_mut().zip(&rig.inputs) {
                    *missing += u32::from(input.is_none());
                }
            }
            let (ignored, lost, errors) = difference(&rig.counters(), &before);
            let kind = match cost {
                Cost::Nothing(kind) | Cost::Dropped(kind) => Some(kind),
                Cost::Reply | Cost::Data => None,
            };
            let expected = std::array::from_fn(|place| u32::from(kind.is_some_and(|kind| kind as usize == place)));
            let reply_lost = u32::from(matches!(cost, Cost::Reply | Cost::Dropped(_)));
            let data_lost = u32::from(of_inputs && !matches!(cost, Cost::Nothing(_)));
            let wrong = if cost == Cost::Data { AXES as u32 } else { 0 };
            let where_from = if of_inputs { "inputs" } else { "outputs" };
            assert_eq!(
                (ignored, lost, errors),
                (expected, reply_lost, wrong),
                "{text}, {where_from}"
            );
            assert_eq!(missing, [data_lost; AXES], "{text}, {where_from}");
        }
    }
    assert_eq!(rig.log[events..], [], "nobody hears of single events");
    assert_well(&rig);
}

#[test]
pub(crate) fn inputs_that_come_with_the_reply_to_the_outputs_are_too_late_for_their_cycle_only() {
    let mut rig = rig("");
    rig.operational();
    rig.run_ms(50);
    let before = rig.counters();
    rig.cell.inject(Fault::Delay(1));
    rig.millisecond();
    assert_eq!(rig.inputs, [None; AXES]);
    rig.run_ms(20);
    assert_eq!(difference(&rig.counters(), &before), ([0; IGNORED_KINDS], 0, 0));
    assert_well(&rig);
}

fn upload(rig: &mut Rig<'_>, slave: u8) -> Vec<u8> {
    rig.value(ServiceRequest::Upload {
        slave,
        object: COMMENT,
        complete: false,
        offset: 0,
    })
}

#[test]
pub(crate) fn an_sdo_is_carried_out_once_whatever_happens_to_the_frames_meanwhile() {
    let mut rig = rig("");
    rig.operational();
    rig.run_ms(50);
    let mut transfers = 0_u32;
    for (text, fault, _) in KINDS {
        for offset_ms in 0..24 {
            for count in [1, 4] {
                transfers += 1;
                let what = format!("{count} {text} after {offset_ms} ms");
                let slave = (transfers % AXES as u32) as u8;
                let value = format!("written in transfer {transfers}").into_bytes();
                let request = ServiceRequest::Download {
                    slave,
                    object: COMMENT,
                    complete: false,
                    total: value.len() as u16,
                    offset: 0,
                    piece: value.iter().copied().collect(),
                };
                assert!(rig.services.enqueue(request).is_ok());
                let mut answer = None;
                for ms in 0..3_000 {
                    if (offset_ms..offset_ms + count).contains(&ms) {
                        rig.cell.inject(fault);
                    }
                    rig.millisecond();
                    answer = answer.or_else(|| rig.answers.dequeue());
                    if answer.is_some() && ms > offset_ms + count {
                        break;
                    }
                }
                assert_eq!(answer, Some(Ok(ServiceReply::Done)), "{what}");
                rig.run_ms(20);
                // Carried out twice, it would have been answered twice.
                let status = rig.value(ServiceRequest::Registers {
                    slave,
                    address: register::sync_manager(1) + register::SYNC_MANAGER_STATUS_OFFSET,
                    length: 1,
                });
                assert_eq!(
                    status[0] & register::MAILBOX_FULL_BIT,
                    0,
                    "{what}: a second answer waits"
                );
                assert_eq!(upload(&mut rig, slave), value, "{what}");
            }
        }
    }
    println!("{transfers} transfers");
    let noise = rig.log.iter().rposition(|event| *event == BusEvent::Operational);
    assert_eq!(noise, Some(rig.log.len() - 1), "{:#?}", rig.log);
    assert_well(&rig);
}

#[test]
pub(crate) fn a_second_master_finds_a_mailbox_in_use_and_is_answered_at_once_or_after_a_moment() {
    // Each length of the first master's conversation leaves another counter behind.
    for messages in 1..=9 {
        let mut first = idle_rig("");
        let state = AlState::PreOperational;
        assert!(first.ask(ServiceRequest::SetState { slave: 1, state }).is_ok());
        for _ in 0..messages {
            upload(&mut first, 1);
        }
        let mut second = idle_rig("");
        std::mem::swap(&mut first.cell, &mut second.cell);
        second.now_ms = first.now_ms + 1_000;
        let started_ms = second.now_ms;
        assert!(upload(&mut second, 1).is_empty(), "after {messages} messages");
        println!(
            "{messages} messages before: answered after {} ms",
            second.now_ms - started_ms
        );
        assert!(second.now_ms - started_ms < 500);
        assert_eq!(second.cell.state().slaves[1].al_state, cell::AlState::PreOperational);
    }
}
