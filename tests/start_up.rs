//! Requirements on the start-up of the board nucleo: its shipped image, run from the reset vector on another Cortex-M7.
//!
//! `tests/startup/run.py` models the chip (unicorn's instruction set from PyPI, installed below the target folder and
//! run as a program of its own) and prints what the firmware did to it. This file holds the requirements: rules of
//! order, final values of registers, a golden trace that shows in review what a change does to the chip, and an end
//! with a reason for everything that never gets ready.
//!
//! After an intended change of the trace, run `ETHERPEN_RENEW_GOLDEN=1 cargo test --test start_up` and review the
//! difference.

use etherpen::config::Config;
use host_tools::emulator::LINK_BYTES_MAX;
use host_tools::firmware_image::Image;
use host_tools::job::{Job, JobOptions};
use std::fmt::Write;
use std::path::Path;

#[path = "startup/rules.rs"]
mod rules;
#[path = "startup/trace.rs"]
mod trace;

use rules::RULES;
use trace::{Event, Run, TASKS_RUN, run, run_of_tasks};

/// The golden trace, from the root.
const GOLDEN: &str = "tests/golden/start_up.txt";
/// Set to write the golden trace instead of comparing with it.
const RENEW: &str = "ETHERPEN_RENEW_GOLDEN";
/// Virtual time in which a start fails, is reported, and fails again.
const FAILS_TWICE: [&str; 2] = ["--until-ms", "5600"];

/// Registers that matter, and what they hold when the start-up is over (RM0433 and the board's manual).
const FINAL: [(&str, u32); 47] = [
    // 8 MHz x 120 / 2: HSE in bypass with the security system, CSI, HSI48, PLL1; source and divider of PLL1.
    ("RCC.CR", 0x030F_3187),
    ("RCC.PLLCKSELR", 0x0202_0012),
    ("RCC.PLLCFGR", 0x01F9_000C),
    ("RCC.PLL1DIVR", 0x0101_0277),
    ("RCC.CFGR", 0x0000_001B),
    ("RCC.D1CFGR", 0x0000_0048),
    ("RCC.D2CFGR", 0x0000_0440),
    ("RCC.D3CFGR", 0x0000_0040),
    ("RCC.D2CCIP2R", 0x0030_0000),
    // Scale 0 is scale 1 with the overdrive; 4 wait states; the USB's supply.
    ("PWR.D3CR", 0x0000_E000),
    ("PWR.CR3", 0x0500_0006),
    ("SYSCFG.PWRCR", 0x0000_0001),
    ("SYSCFG.CCCSR", 0x0000_0101),
    ("SYSCFG.PMCR", 0x0080_0000),
    ("FLASH.ACR", 0x0000_0024),
    ("DBGMCU.CR", 0x0060_0001),
    ("DBGMCU.APB4FZR1", 0x0004_0000),
    // Ethernet AF11, USB AF10, serial line AF7; lamps PB0, PE1, PB14; emergency stop PG14 with its pull-up.
    ("GPIOA.MODER", 0xAABF_BFEB),
    ("GPIOA.AFRL", 0xB000_0BB0),
    ("GPIOA.AFRH", 0x000A_A000),
    ("GPIOB.MODER", 0xDBFF_FEBD),
    ("GPIOB.AFRH", 0x00B0_0000),
    ("GPIOC.MODER", 0xFFFF_FAFB),
    ("GPIOC.AFRL", 0x00BB_00B0),
    ("GPIOD.MODER", 0xFFFA_FFFF),
    ("GPIOD.AFRH", 0x0000_0077),
    ("GPIOD.PUPDR", 0x0004_0000),
    ("GPIOE.MODER", 0xFFFF_FFF7),
    ("GPIOG.MODER", 0xCBBF_FFFF),
    ("GPIOG.AFRH", 0x00B0_B000),
    ("GPIOG.PUPDR", 0x1000_0000),
    // 120 MHz / 130 is 923 kBd; the FIFO at half, and errors of the line.
    ("USART3.BRR", 130),
    ("USART3.CR1", 0x2000_001D),
    // 60 MHz: 1 ms, the deadline 300 us behind.
    ("TIM1.PSC", 3),
    ("TIM1.CCR1", 18_000),
    ("TIM1.DIER", 3),
    ("IWDG1.RLR", 400),
    // 100 Mbit/s, full duplex, the bit that is reserved and set; own frames only.
    ("ETH.MACCR", 0x0030_E003),
    ("ETH.MACPFR", 0x0000_0200),
    ("ETH.DMACTXDLAR", 0x3004_3080),
    ("ETH.DMACRXDLAR", 0x3004_0000),
    ("ETH.DMACTXRLR", 7),
    ("ETH.DMACRXRLR", 7),
    ("ETH.DMACTXCR", 0x0008_0001),
    ("ETH.DMACRXCR", 0x0008_0C01),
    ("ETH.DMACIER", 0x0000_D0C0),
    ("MPU.CTRL", 5),
];
/// The regions of the MPU by number: base, attributes and size.
const MPU_REGIONS: [(u32, u32); 3] = [
    // SRAM1 to SRAM3: 512 KiB less three eighths, normal, not cached, shared, never executed.
    (0x3000_0000, 0x130C_E025),
    // ITCM: 64 KiB, read-only.
    (0x0000_0000, 0x0608_001F),
    // 0x6000_0000 to 0x9FFF_FFFF: two eighths of everything, no access, never executed.
    (0x0000_0000, 0x1000_E73F),
];
/// Ready bits that a start requires, as `run.py` names them, and a part of the message without them.
const NEEDED: [(&str, &str); 11] = [
    ("ACTVOS", "core voltage (ACTVOSRDY)"),
    ("VOS", "voltage scale 1 (VOSRDY)"),
    ("OVERDRIVE", "voltage scale 0 (VOSRDY)"),
    ("HSI", "internal oscillator (HSIRDY)"),
    ("CSI", "CSIRDY"),
    ("HSI48", "HSI48RDY"),
    ("PLL1", "PLL (PLL1RDY)"),
    ("LATENCY", "flash wait states"),
    ("COMPENSATION", "compensation of fast outputs"),
    ("SWS", "switch to the PLL"),
    // The driver of the USB waits for this one without a bound of its own.
    ("CSRST", "step \"USB\" did not end"),
];
/// Ready bits without which the firmware runs: the USB's supply, the management interface.
const SPARED: [&str; 2] = ["USB33", "MDIO"];

fn assert_rules(run: &Run, what: &str) {
    for rule in &RULES {
        let broken = (rule.broken)(&run.events);
        assert!(broken.is_empty(), "{what}: {}:\n{}", rule.name, broken.join("\n"));
    }
}

#[test]
fn the_start_up_keeps_every_rule_with_the_clock_there_late_and_absent() {
    let Some(tasks) = run_of_tasks() else { return };
    assert_rules(tasks, "into the tasks");
    // Only the run above contains what the Ethernet's DMA has to keep.
    let variants: [&[&str]; 4] = [
        &["--hse-at-ms", "700"],
        &["--hse-absent"],
        &["--no-phy", "--until-ms", "60"],
        &["--seed", "2"],
    ];
    for options in variants {
        let Some(run) = run(options) else { return };
        println!("{options:?}: {} events, {}", run.events.len(), run.end);
        assert_eq!(run.resets(), ["power-on"], "{options:?}");
        assert!(run.events.contains(&Event::Wfi), "{options:?}: {}", run.end);
        let start = Run {
            events: run.start_up().to_vec(),
            ..run
        };
        assert_rules(&start, &format!("{options:?}"));
    }
}

#[test]
fn every_rule_notices_what_breaks_it() {
    let Some(run) = run_of_tasks() else { return };
    for rule in &RULES {
        let mut trace = run.events.clone();
        (rule.plant)(&mut trace);
        assert!(!(rule.broken)(&trace).is_empty(), "not noticed: {}", rule.name);
    }
}

#[test]
fn every_register_that_matters_has_its_value() {
    let Some(run) = run_of_tasks() else { return };
    let wrong = FINAL.iter().filter_map(|(name, value)| {
        let is = run.finals.get(*name).copied();
        (is != Some(*value)).then(|| format!("{name}: {is:#010x?} instead of {value:#010x}"))
    });
    let wrong: Vec<_> = wrong.collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    let (mut regions, mut region, mut base) = ([(0, 0); 8], 0, 0);
    for event in &run.events {
        match event {
            Event::Write(name, value) if name == "MPU.RNR" => region = *value as usize,
            Event::Write(name, value) if name == "MPU.RBAR" => base = *value,
            Event::Write(name, value) if name == "MPU.RASR" => regions[region] = (base, *value),
            _ => {}
        }
    }
    assert_eq!(regions[..3], MPU_REGIONS, "{regions:x?}");
    assert!(regions[3..].iter().all(|region| *region == (0, 0)));
}

#[test]
fn what_the_memories_hold_at_power_on_changes_nothing_and_the_ethernets_is_cleared() {
    let Some(first) = run(&["--seed", "1"]) else { return };
    for seed in ["2", "3"] {
        let Some(other) = run(&["--seed", seed]) else { return };
        assert_eq!(first.start_up(), other.start_up(), "seed {seed}");
        assert_eq!(other.finals.get("SRAM3.not_zero"), Some(&0), "seed {seed}");
        assert_ne!(other.finals.get("SRAM1.not_zero"), Some(&0), "the model fills memories");
    }
}

#[test]
fn the_trace_is_the_golden_one() {
    let Some(run) = run(&[]) else { return };
    let mut trace = String::new();
    for (event, next) in run
        .start_up()
        .iter()
        .zip(run.start_up().iter().skip(1).chain([&Event::Wfi]))
    {
        match event {
            Event::Write(name, value) => writeln!(trace, "write {name} {value:#010x}").expect("memory"),
            // Reads before a change, of counters, and of the check of all priorities carry no information.
            Event::Read(name, _) if matches!(next, Event::Write(other, _) if other == name) => {}
            Event::Read(name, _) if name.starts_with("NVIC.") || name.starts_with("SCB.") || name.ends_with(".CNT") => {
            }
            Event::Read(name, value) => writeln!(trace, "read {name} {value:#010x}").expect("memory"),
            other => writeln!(trace, "{other:?}").expect("memory"),
        }
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(GOLDEN);
    if std::env::var_os(RENEW).is_some() {
        std::fs::write(&path, &trace).expect("the golden trace can be written");
        return;
    }
    let golden = std::fs::read_to_string(&path).expect("the golden trace; see this file's header for how to make it");
    for (number, (golden, now)) in golden.lines().zip(trace.lines()).enumerate() {
        assert_eq!(golden, now, "{GOLDEN}, line {}; {RENEW}=1 renews it", number + 1);
    }
    assert_eq!(
        golden.lines().count(),
        trace.lines().count(),
        "lines of {GOLDEN}; {RENEW}=1 renews it"
    );
}

/// What LD1 to LD3 show after each change of all three, in the order of the writes.
fn lamps(run: &Run) -> Vec<[bool; 3]> {
    let mut shown = [false; 3];
    let mut all = Vec::new();
    for event in &run.events {
        let Event::Write(name, value) = event else { continue };
        match (name.as_str(), value) {
            ("GPIOB.BSRR", 0x0000_0001) => shown[0] = true,
            ("GPIOB.BSRR", 0x0001_0000) => shown[0] = false,
            ("GPIOE.BSRR", 0x0000_0002) => shown[1] = true,
            ("GPIOE.BSRR", 0x0002_0000) => shown[1] = false,
            ("GPIOB.BSRR", 0x0000_4000) => shown[2] = true,
            ("GPIOB.BSRR", 0x4000_0000) => shown[2] = false,
            _ => continue,
        }
        // LD3 is the last of the three.
        if name == "GPIOB.BSRR" && value & 0x4000_4000 != 0 {
            all.push(shown);
        }
    }
    all
}

/// Asserts that a start failed, reported why on lamps and serial line, and was tried again.
fn assert_reported(run: &Run, by: &str, why: &str) {
    let resets = run.resets();
    assert!(
        resets.len() >= 3 && resets[1..].iter().all(|cause| *cause == by),
        "{resets:?}"
    );
    assert!(run.text().contains("etherpen: the start failed"), "{:?}", run.text());
    assert!(run.text().contains(why), "{why}: {:?}", run.text());
    let lamps = lamps(run);
    assert_eq!(lamps.first(), Some(&[true; 3]), "all lamps at first");
    let (yellow, red) = ([false, true, false], [false, false, true]);
    let pairs = lamps.windows(2).filter(|pair| *pair == [yellow, red]).count();
    assert!(pairs >= 8, "yellow and red in turn: {pairs} of {}", lamps.len());
    assert!(!run.events.contains(&Event::Wfi), "it never runs");
}

#[test]
fn a_ready_bit_that_never_comes_is_told_by_lamps_and_serial_line_and_tried_again() {
    for (bit, why) in NEEDED {
        let Some(run) = run(&["--stuck", bit, FAILS_TWICE[0], FAILS_TWICE[1]]) else {
            return;
        };
        println!("{bit}: {:?}, {}", run.resets(), run.end);
        let by = if bit == "CSRST" { "watchdog" } else { "software" };
        assert_reported(&run, by, why);
    }
    for bit in SPARED {
        let Some(run) = run(&["--stuck", bit, TASKS_RUN[0], TASKS_RUN[1]]) else {
            return;
        };
        assert_eq!(run.resets(), ["power-on"], "{bit}");
        assert!(run.frames().count() > 10, "{bit}: {}", run.end);
    }
}

#[test]
fn revision_y_is_refused_by_lamps_and_serial_line_before_the_clocks_change() {
    let Some(run) = run(&["--revision", "Y", FAILS_TWICE[0], FAILS_TWICE[1]]) else {
        return;
    };
    assert_reported(&run, "software", "silicon revision Y");
    let touched = |event: &&Event| matches!(event, Event::Write(name, _) if name.starts_with("RCC.PLL") || name.starts_with("PWR."));
    assert_eq!(run.events.iter().find(touched), None);
}

fn source(run: &Run) -> u32 {
    run.finals.get("RCC.PLLCKSELR").map_or(0, |select| select & 3)
}

#[test]
fn the_8_mhz_are_waited_for_two_seconds_and_taken_when_they_come_later() {
    const HSI: u32 = 0;
    const HSE: u32 = 2;
    let Some(late) = run(&["--hse-at-ms", "1900"]) else {
        return;
    };
    assert_eq!((source(&late), late.resets()), (HSE, vec!["power-on"]), "{}", late.end);
    let Some(never) = run(&["--hse-absent"]) else { return };
    assert_eq!(
        (source(&never), never.resets()),
        (HSI, vec!["power-on"]),
        "{}",
        never.end
    );
    assert_eq!(
        never.finals.get("RCC.CR").map(|control| control >> 19 & 1),
        Some(0),
        "no clock to guard"
    );
    let Some(later) = run(&["--hse-at-ms", "2060", "--until-ms", "2120"]) else {
        return;
    };
    println!("{:?}, {}", later.resets(), later.end);
    assert_eq!((source(&later), later.resets()), (HSE, vec!["power-on", "software"]));
    let again = later
        .events
        .iter()
        .rposition(|event| matches!(event, Event::Reset(_)))
        .expect("the reset");
    let sent = later.events[again..]
        .iter()
        .filter(|event| matches!(event, Event::Frame(_)))
        .count();
    assert!(sent > 10, "the tasks run again: {sent}");
}

#[test]
fn a_clock_that_stops_ends_the_firmware_which_starts_again_without_it() {
    let Some(run) = run(&["--hse-stops-ms", "40", "--until-ms", "2120"]) else {
        return;
    };
    println!("{:?}, {}", run.resets(), run.end);
    assert_eq!((source(&run), run.resets()), (0, vec!["power-on", "software"]));
    let asleep = run.events.iter().filter(|event| **event == Event::Wfi).count();
    assert_eq!(asleep, 2, "it runs before and after");
}

#[test]
fn the_first_telegram_goes_out_and_the_first_greeting_is_answered() {
    let mut host = Job::draw(Config::default(), Vec::new(), JobOptions::default());
    let mut greeting = Vec::new();
    host.step(0, &[], &mut greeting, LINK_BYTES_MAX);
    let greeting = greeting
        .iter()
        .fold(String::new(), |text, byte| text + &format!("{byte:02x}"));
    let Some(run) = run(&["--host", &greeting, "--until-ms", "70"]) else {
        return;
    };
    assert_eq!(run.resets(), ["power-on"]);
    let frames: Vec<_> = run.frames().collect();
    // To everybody, EtherCAT, one telegram, a broadcast read of the AL status.
    assert!(
        frames.len() > 10
            && frames
                .iter()
                .all(|frame| frame[..6] == [0xFF; 6] && frame[12..14] == [0x88, 0xA4])
    );
    assert_eq!((frames[0][15] >> 4, frames[0][16]), (1, 7), "{:x?}", frames[0]);
    assert!(
        run.events
            .iter()
            .any(|event| matches!(event, Event::Phy(told) if told.contains("register 4 = 0x0101")))
    );
    host.step(10, &run.serial(), &mut Vec::new(), LINK_BYTES_MAX);
    let welcome = host.welcome().expect("the firmware has answered");
    println!("{} frames; {welcome:?}", frames.len());
    assert_eq!(welcome.board.as_str(), "nucleo");
}

#[test]
fn a_debug_probe_that_reads_no_more_holds_nothing_up() {
    let Some(image) = trace::image() else { return };
    let image = Image::read(image).expect("it is an image");
    let block = image
        .symbols()
        .iter()
        .find(|symbol| symbol.name == "_SEGGER_RTT")
        .expect("the log's control block");
    let address = format!("{:#x}", block.address);
    let Some(run) = run(&["--full-log", &address, "--until-ms", "100"]) else {
        return;
    };
    println!("{} frames, {}", run.frames().count(), run.end);
    assert_eq!(run.resets(), ["power-on"], "the watchdog has ended the firmware");
    assert!(run.frames().count() > 70, "{}", run.frames().count());
}
