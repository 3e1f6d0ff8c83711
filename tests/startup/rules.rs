//! Rules for the order of a start-up of the STM32H743, and for what it must not touch.
//!
//! Each rule comes from the reference manual (RM0433) and reports what breaks it in a trace. Each has a way to break
//! it, so that a test can show that the rule detects it.

use crate::trace::Event;
use std::collections::{HashMap, HashSet};

/// A rule.
pub(crate) struct Rule {
    pub(crate) name: &'static str,
    /// What in a trace breaks it.
    pub(crate) broken: fn(&[Event]) -> Vec<String>,
    /// Breaks it in a trace that keeps it.
    pub(crate) plant: fn(&mut Vec<Event>),
}

pub(crate) const RULES: [Rule; 13] = [
    Rule {
        name: "a peripheral is clocked, and its clock read back, before it is accessed",
        broken: clocked_before_access,
        plant: |trace| change(trace, "RCC.APB1LENR", |value| value & !(1 << 18)),
    },
    Rule {
        name: "the clock's register is read after the clock is switched on",
        broken: clocked_before_access,
        plant: |trace| trace.retain(|event| !matches!(event, Event::Read(name, _) if name == "RCC.AHB1ENR")),
    },
    Rule {
        name: "the watchdog runs and the lamps are on before anything is waited for",
        broken: watchdog_and_lamps_first,
        plant: |trace| move_before(trace, "PWR.D3CR", "IWDG1.KR"),
    },
    Rule {
        name: "the bypass of the HSE changes only while it is off",
        broken: bypass_while_off,
        plant: |trace| {
            change(trace, "RCC.CR", |value| {
                value & !(1 << 18) | value >> 6 & 1 << 18 | 1 << 16
            })
        },
    },
    Rule {
        name: "the PLL's source and dividers are written only while every PLL is off",
        broken: pll_set_while_off,
        plant: |trace| move_behind(trace, "RCC.PLLCKSELR", "RCC.CFGR"),
    },
    Rule {
        name: "voltage, PLL, dividers and wait states are ready before the PLL is the system's clock",
        broken: ready_before_switch,
        plant: |trace| move_behind(trace, "FLASH.ACR", "RCC.CFGR"),
    },
    Rule {
        name: "bits that belong to nobody or to others keep their value after a reset",
        broken: bits_kept,
        plant: |trace| change(trace, "ETH.MACCR", |value| value & !(1 << 15)),
    },
    Rule {
        name: "a pin's function is chosen before its mode",
        broken: function_before_mode,
        plant: |trace| move_behind(trace, "GPIOD.AFRH", "GPIOD.MODER"),
    },
    Rule {
        name: "the MPU is on before the data cache",
        broken: mpu_before_cache,
        plant: |trace| change(trace, "MPU.CTRL", |_| 0),
    },
    Rule {
        name: "RMII is selected while the MAC is in reset and before it is clocked",
        broken: rmii_before_clock,
        plant: |trace| move_behind(trace, "SYSCFG.PMCR", "RCC.AHB1ENR"),
    },
    Rule {
        name: "the serial line has its rate before it is enabled",
        broken: rate_before_enable,
        plant: |trace| trace.retain(|event| !matches!(event, Event::Write(name, _) if name == "USART3.BRR")),
    },
    Rule {
        name: "lists and their lengths are told before tail pointers and before the DMA starts",
        broken: list_before_tail,
        plant: |trace| move_behind(trace, "ETH.DMACRXDLAR", "ETH.DMACRXDTPR"),
    },
    Rule {
        name: "the DMA runs before the MAC",
        broken: dma_before_mac,
        plant: |trace| change(trace, "ETH.DMACRXCR", |value| value & !1),
    },
];

/// Register and bit that clock a peripheral (RM0433, RCC).
const CLOCKS: [(&str, &str, u32); 13] = [
    ("GPIOA", "RCC.AHB4ENR", 0),
    ("GPIOB", "RCC.AHB4ENR", 1),
    ("GPIOC", "RCC.AHB4ENR", 2),
    ("GPIOD", "RCC.AHB4ENR", 3),
    ("GPIOE", "RCC.AHB4ENR", 4),
    ("GPIOG", "RCC.AHB4ENR", 6),
    ("SYSCFG", "RCC.APB4ENR", 1),
    ("TIM2", "RCC.APB1LENR", 0),
    ("USART3", "RCC.APB1LENR", 18),
    ("CRS", "RCC.APB1HENR", 1),
    ("TIM1", "RCC.APB2ENR", 0),
    ("ETH", "RCC.AHB1ENR", 15),
    ("OTG_FS", "RCC.AHB1ENR", 27),
];
/// Peripherals that need no clock of their own.
const UNCLOCKED: [&str; 11] = [
    "RCC", "PWR", "FLASH", "DBGMCU", "IWDG1", "SYST", "NVIC", "MPU", "SCB", "DWT", "ITM",
];

/// Register, bits, and the value that every write to it has to keep in them: reserved ones, debug pins, other PLLs.
const KEPT: [(&str, u32, u32); 15] = [
    ("RCC.CR", 0x0000_0083, 0x0000_0083),
    ("RCC.PLLCKSELR", 0x03F3_F000, 0x0202_0000),
    ("RCC.PLLCFGR", 0x01F8_0000, 0x01F8_0000),
    ("RCC.PLL1DIVR", 0x7F7F_0000, 0x0101_0000),
    ("RCC.AHB1LPENR", 0x0E03_C023, 0x0E03_C023),
    ("PWR.CR3", 0x0000_0007, 0x0000_0006),
    ("CRS.CFGR", 0x0FFF_FFFF, 0x0022_BB7F),
    ("GPIOA.MODER", 0xFC00_0000, 0xA800_0000),
    ("GPIOB.MODER", 0x0000_03C0, 0x0000_0280),
    ("ETH.MACCR", 0x0000_8000, 0x0000_8000),
    ("ETH.MACA0HR", 0x8000_0000, 0x8000_0000),
    ("ETH.MTLTXQOMR", 0x0007_0008, 0x0007_0008),
    ("ETH.MTLRXQOMR", 0x0070_0000, 0x0070_0000),
    ("OTG_FS.DCFG", 0x0220_0000, 0x0220_0000),
    ("SCB.CCR", 0x0004_0200, 0x0004_0200),
];

/// Last value written to each register; empty after a reset.
#[derive(Default)]
struct Chip<'a>(HashMap<&'a str, u32>);

impl<'a> Chip<'a> {
    /// Takes an event in.
    fn note(&mut self, event: &'a Event) {
        match event {
            Event::Reset(_) => self.0.clear(),
            Event::Write(name, value) => drop(self.0.insert(name, *value)),
            // The reset of MAC and DMA clears their settings.
            Event::Read(name, value) if name == "ETH.DMAMR" && value & 1 == 0 => {
                self.0.retain(|name, _| !name.starts_with("ETH."));
            }
            _ => {}
        }
    }

    fn get(&self, name: &str) -> u32 {
        self.0.get(name).copied().unwrap_or(0)
    }

    fn has(&self, name: &str) -> bool {
        self.0.contains_key(name)
    }
}

/// What `look` finds wrong with a write, given all that was written before it.
fn writes(trace: &[Event], look: impl Fn(&Chip, &str, u32) -> Option<String>) -> Vec<String> {
    let mut chip = Chip::default();
    let mut wrong = Vec::new();
    for event in trace {
        if let Event::Write(name, value) = event {
            wrong.extend(look(&chip, name, *value));
        }
        chip.note(event);
    }
    wrong
}

fn clocked_before_access(trace: &[Event]) -> Vec<String> {
    let mut chip = Chip::default();
    let mut read_back: HashSet<&str> = HashSet::new();
    let mut wrong = Vec::new();
    for event in trace {
        if let Event::Write(name, _) | Event::Read(name, _) = event {
            let peripheral = name.split('.').next().unwrap_or_default();
            match CLOCKS.iter().find(|(clocked, ..)| *clocked == peripheral) {
                Some((_, register, bit)) => {
                    if chip.get(register) >> bit & 1 == 0 {
                        wrong.push(format!("{name} without its clock"));
                    } else if !read_back.contains(register) {
                        wrong.push(format!("{name} right behind its clock"));
                    }
                }
                None if UNCLOCKED.contains(&peripheral) => {}
                None => wrong.push(format!("{name} is of no peripheral that is known")),
            }
            match event {
                Event::Write(..) if name.ends_with("ENR") => drop(read_back.remove(name.as_str())),
                // All of them are on one bus: a read of any behind the write has waited for it.
                Event::Read(..) if name.ends_with("ENR") => read_back.extend(CLOCKS.map(|(_, register, _)| register)),
                _ => {}
            }
        }
        chip.note(event);
    }
    wrong
}

fn watchdog_and_lamps_first(trace: &[Event]) -> Vec<String> {
    let at = |wanted: &str| {
        trace
            .iter()
            .position(|event| matches!(event, Event::Write(name, _) if name == wanted))
    };
    let waited = trace
        .iter()
        .position(|event| matches!(event, Event::Write(name, _) if name.starts_with("PWR.")));
    let is_before = |name| matches!((at(name), waited), (Some(at), Some(waited)) if at < waited);
    let first = ["IWDG1.KR", "GPIOB.BSRR", "GPIOE.BSRR"];
    let late = first.iter().filter(|name| !is_before(name));
    late.map(|name| format!("{name} is late")).collect()
}

fn bypass_while_off(trace: &[Event]) -> Vec<String> {
    writes(trace, |chip, name, value| {
        let before = chip.get(name);
        let changes = name == "RCC.CR" && (before ^ value) >> 18 & 1 == 1;
        let is_on = (before | value) >> 16 & 1 == 1;
        (changes && is_on).then(|| format!("{name} {value:#010x}"))
    })
}

fn pll_set_while_off(trace: &[Event]) -> Vec<String> {
    const PLLS_ON: u32 = 1 << 24 | 1 << 26 | 1 << 28;
    let mut wrong = writes(trace, |chip, name, value| {
        let set = name.starts_with("RCC.PLL");
        (set && chip.get("RCC.CR") & PLLS_ON != 0).then(|| format!("{name} {value:#010x}"))
    });
    wrong.extend(trace.iter().filter_map(|event| match event {
        Event::Ignored(name) => Some(format!("the chip ignores {name}")),
        _ => None,
    }));
    wrong
}

fn ready_before_switch(trace: &[Event]) -> Vec<String> {
    let mut seen: HashMap<&str, u32> = HashMap::new();
    let mut wrong = Vec::new();
    let mut chip = Chip::default();
    for event in trace {
        match event {
            Event::Reset(_) => seen.clear(),
            Event::Read(name, value) => drop(seen.insert(name, *value)),
            Event::Write(name, value) if name == "RCC.CFGR" && value & 7 == 3 => {
                let read = |name: &str| seen.get(name).copied().unwrap_or(0);
                let needed = [
                    ("scale 1 and ready", read("PWR.D3CR") & 0xE000 == 0xE000),
                    ("overdrive", chip.get("SYSCFG.PWRCR") & 1 == 1),
                    ("PLL locked", read("RCC.CR") >> 25 & 1 == 1),
                    ("source read back", read("RCC.PLLCKSELR") == chip.get("RCC.PLLCKSELR")),
                    ("wait states", read("FLASH.ACR") & 0x3F == 0x24),
                    ("bus dividers", chip.get("RCC.D1CFGR") & 0xF7F == 0x48),
                    ("peripherals' dividers", chip.get("RCC.D2CFGR") & 0x770 == 0x440),
                ];
                wrong.extend(
                    needed
                        .iter()
                        .filter(|(_, met)| !met)
                        .map(|(what, _)| (*what).to_owned()),
                );
            }
            _ => {}
        }
        chip.note(event);
    }
    wrong
}

fn bits_kept(trace: &[Event]) -> Vec<String> {
    writes(trace, |_, name, value| {
        let (_, mask, kept) = KEPT.iter().find(|(register, ..)| *register == name)?;
        (value & mask != *kept).then(|| format!("{name} {value:#010x} loses {:#010x}", (value & mask) ^ kept))
    })
}

fn function_before_mode(trace: &[Event]) -> Vec<String> {
    writes(trace, |chip, name, value| {
        let port = name.strip_suffix(".MODER")?;
        let function = |pin: u32| {
            let half = if pin < 8 { "AFRL" } else { "AFRH" };
            chip.get(&format!("{port}.{half}")) >> (4 * (pin % 8)) & 0xF
        };
        let before = if chip.has(name) { chip.get(name) } else { value };
        let made = (0..16).filter(|pin| value >> (2 * pin) & 3 == 2 && before >> (2 * pin) & 3 == 3);
        let early: Vec<_> = made.filter(|pin| function(*pin) == 0).collect();
        let first = !chip.has(name)
            && (0..16).any(|pin| {
                let is_debug = (port == "GPIOA" && pin >= 13) || (port == "GPIOB" && (3..5).contains(&pin));
                value >> (2 * pin) & 3 == 2 && function(pin) == 0 && !is_debug
            });
        (!early.is_empty() || first).then(|| format!("{name} {value:#010x}"))
    })
}

fn mpu_before_cache(trace: &[Event]) -> Vec<String> {
    writes(trace, |chip, name, value| {
        let caches = name == "SCB.CCR" && value >> 16 & 3 != 0;
        (caches && chip.get("MPU.CTRL") != 5)
            .then(|| format!("{name} {value:#010x} with MPU.CTRL {}", chip.get("MPU.CTRL")))
    })
}

fn rmii_before_clock(trace: &[Event]) -> Vec<String> {
    writes(trace, |chip, name, value| {
        let clocks = name == "RCC.AHB1ENR" && value >> 15 & 7 != 0 && chip.get(name) >> 15 & 7 == 0;
        let is_rmii = chip.get("SYSCFG.PMCR") >> 21 & 7 == 4;
        let in_reset = chip.get("RCC.AHB1RSTR") >> 15 & 1 == 1;
        (clocks && !(is_rmii && in_reset)).then(|| format!("RMII {is_rmii}, in reset {in_reset}"))
    })
}

fn rate_before_enable(trace: &[Event]) -> Vec<String> {
    writes(trace, |chip, name, value| {
        (name == "USART3.CR1" && value & 1 == 1 && !chip.has("USART3.BRR")).then(|| "no rate".to_owned())
    })
}

fn list_before_tail(trace: &[Event]) -> Vec<String> {
    writes(trace, |chip, name, value| {
        let (direction, starts) = match name {
            "ETH.DMACTXDTPR" | "ETH.DMACTXCR" => ("TX", name.ends_with("PR") || value & 1 == 1),
            "ETH.DMACRXDTPR" | "ETH.DMACRXCR" => ("RX", name.ends_with("PR") || value & 1 == 1),
            _ => return None,
        };
        let told = ["DLAR", "RLR"].map(|register| chip.has(&format!("ETH.DMAC{direction}{register}")));
        (starts && told != [true, true]).then(|| format!("{name} {value:#010x} before its list"))
    })
}

fn dma_before_mac(trace: &[Event]) -> Vec<String> {
    writes(trace, |chip, name, value| {
        let runs = |register| chip.get(register) & 1 == 1;
        let dma = runs("ETH.DMACTXCR") && runs("ETH.DMACRXCR");
        (name == "ETH.MACCR" && value & 3 != 0 && !dma).then(|| format!("{name} {value:#010x}"))
    })
}

/// Changes what is written to a register.
fn change(trace: &mut [Event], register: &str, change: impl Fn(u32) -> u32) {
    for event in trace {
        if let Event::Write(name, value) = event
            && name == register
        {
            *value = change(*value);
        }
    }
}

fn first(trace: &[Event], register: &str) -> usize {
    let is_it = |event: &Event| matches!(event, Event::Write(name, _) if name == register);
    trace
        .iter()
        .position(is_it)
        .unwrap_or_else(|| panic!("{register} is written"))
}

/// Moves all writes to a register before the first one to another.
fn move_before(trace: &mut Vec<Event>, register: &str, other: &str) {
    let (moved, rest) = trace
        .drain(..)
        .partition(|event| matches!(event, Event::Write(name, _) if name == register));
    *trace = rest;
    let at = first(trace, other);
    drop(trace.splice(at..at, Vec::from_iter::<Vec<Event>>(moved)));
}

/// Moves all that was written to and read of a register behind the last write to another.
fn move_behind(trace: &mut Vec<Event>, register: &str, other: &str) {
    let is_of = |event: &Event, register: &str| matches!(event, Event::Write(name, _) | Event::Read(name, _) if name == register);
    let (moved, rest): (Vec<Event>, Vec<Event>) = trace.drain(..).partition(|event| is_of(event, register));
    *trace = rest;
    let is_other = |event: &Event| matches!(event, Event::Write(name, _) if name == other);
    let at = trace
        .iter()
        .rposition(is_other)
        .unwrap_or_else(|| panic!("{other} is written"))
        + 1;
    drop(trace.splice(at..at, moved));
}
