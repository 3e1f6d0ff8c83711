//! Requirements on the firmware images, read from the machine code: sizes, addresses, and what the critical tasks may
//! reach.
//!
//! `ETHERPEN_RENEW_ITCM=1 cargo test --test images tightly_coupled` rewrites the list of the functions in ITCM.

use etherpen as _;
use host_tools::firmware_image::{CallGraph, Function, Image, StackBound, section_pattern};
use host_tools::setup;
use std::collections::BTreeSet;
use std::ops::Range;

/// Most flash memory of an image, bytes.
const FLASH_BYTES_MAX: u32 = 1024 * 1024;
/// Most static memory, bytes, without the black box.
const STATIC_BYTES_MAX: u32 = 272 * 1024;
/// Most tightly coupled data memory, stacks included, bytes.
const DTCM_BYTES_MAX: u32 = 96 * 1024;
/// The functions in ITCM, as patterns for the linker.
const ITCM_LIST: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/src/bin/nucleo/itcm.x");
const RENEW: &str = "ETHERPEN_RENEW_ITCM";
/// Parts of the names of functions that may lie in flash: they run only while the axes are led to their switches, and take a
/// few hundred instructions, or once when the axes are homed, and when a plan, a configuration or the network's addresses are
/// taken over.
const IN_FLASH: [&[&str]; 13] = [
    &["7control", "6search"],
    &["10robot_axes", "9RobotAxes4home17"],
    &["10robot_axes", "9RobotAxes7home_at17"],
    &["7sampler", "9searching"],
    &["16leave_out_absent"],
    &["6cyclic", "Exchange", "5adopt"],
    &["EtherCatGroup", "5adopt"],
    &["10robot_axes", "5adopt"],
    &["10robot_axes", "9configure"],
    &["2io", "2Io", "9configure"],
    &["6cyclic", "Exchange", "17set_encapsulation"],
    &["7sampler", "Sampler", "17renew_controllers"],
    &["15torque_feedback", "11TorqueModel", "3new"],
];
/// Tightly coupled memory for code, and for data.
const ITCM: Range<u32> = 0..64 * 1024;
const DTCM: Range<u32> = 0x2000_0000..0x2002_0000;
/// Memory of what is neither critical nor reached by the Ethernet DMA.
const AXI_SRAM: Range<u32> = 0x2400_0000..0x2408_0000;
/// Part of the name of the USB's static: the driver's state and the received packets.
const USB_STATIC: &str = "local_init_usb_memory";
/// The flash memory.
const FLASH: Range<u32> = 0x0800_0000..0x0820_0000;
/// Parts of the names of the critical tasks' own statics.
const CRITICAL_STATICS: [&str; 5] = [
    "local_init_parts",
    "local_init_frame_port",
    "shared_resource_sampler",
    "shared_resource_frame_port",
    "shared_resource_watch",
];
/// Parts of the names of what a debug probe reads of the log: control block, channel's name, buffer.
const LOG_STATICS: [&str; 3] = ["_SEGGER_RTT", "9defmt_rtt4NAME", "9defmt_rtt6BUFFER"];
/// What the processor pushes for an exception: 26 words with floating-point registers, and a word of alignment.
const EXCEPTION_FRAME_BYTES: u32 = 108;
/// Tasks of the board nucleo by priority, from the highest; those of one priority never nest.
const NUCLEO_LEVELS: [(u8, &[&str]); 6] = [
    (15, CRITICAL),
    (10, &["USART3"]),
    (8, &["LPTIM1"]),
    (6, &["LPTIM2"]),
    (3, &["LPTIM3", "OTG_FS"]),
    (1, &["LPTIM4", "LPTIM5"]),
];
const CRITICAL: &[&str] = &["TIM1_UP", "ETH", "TIM1_CC"];
/// The panic handler, which masks all interrupts, stores the cause and resets.
const PANIC: &str = "rust_begin_unwind";
/// Parts of the names of functions that a critical task must not reach.
const FORBIDDEN: [(&str, &str); 5] = [
    ("panicking", "may panic"),
    ("_fail", "may panic"),
    ("_critical_section_1_0_", "takes a critical section"),
    ("_defmt_", "logs"),
    ("div_rem", "divides in a loop that depends on the data"),
];

fn nucleo() -> Image {
    let path = setup::build_firmware("nucleo").expect("the firmware is built");
    Image::read(&path).expect("it is an image")
}

fn task<'a>(image: &'a Image, name: &str) -> &'a Function {
    image.function(name).unwrap_or_else(|| panic!("no task {name}"))
}

#[test]
fn the_image_keeps_its_budget_and_lies_where_it_must() {
    let image = nucleo();
    let size = |name: &str| image.section(name).map_or(0, |section| section.size);
    let statics: u32 = [".data", ".rtt", ".bss", ".uninit", ".dtcm", ".eth_dma"]
        .map(size)
        .iter()
        .sum();
    println!("flash {} bytes, static memory {statics} bytes", image.flash_bytes());
    assert!(image.flash_bytes() <= FLASH_BYTES_MAX);
    assert!(statics <= STATIC_BYTES_MAX);
    let at = |name: &str| image.section(name).map(|section| section.address);
    assert_eq!(at(".vector_table"), Some(0x0800_0000));
    assert!(at(".bss").is_some_and(|address| AXI_SRAM.contains(&address)));
    let usb = image.symbols().iter().find(|symbol| symbol.name.contains(USB_STATIC));
    assert!(
        usb.is_some_and(|usb| usb.size > 0 && AXI_SRAM.contains(&usb.address)),
        "the USB's packets, which the processor copies, take no room of the critical tasks and of the Ethernet DMA"
    );
    let dma = image.section(".eth_dma").expect("DMA memory");
    assert!(
        dma.size > 0 && dma.address == 0x3004_0000 && dma.size <= 32 * 1024,
        "SRAM3, which the Ethernet DMA reaches"
    );
    let black_box = image.section(".black_box").expect("the black box");
    assert_eq!(
        (black_box.address, black_box.size),
        (0x3000_0000, 256 * 1024),
        "SRAM1 and SRAM2, which no start clears and no cache covers"
    );
    assert!(image.has_double_precision());
}

#[test]
fn critical_tasks_reach_no_panic_no_critical_section_no_log_and_no_unbounded_division() {
    let image = nucleo();
    let graph = CallGraph::new(&image, &[PANIC]);
    let mut broken = Vec::new();
    for name in CRITICAL {
        let root = task(&image, name);
        let reachable = graph.reachable(root);
        println!("{name} reaches {} functions", reachable.len());
        assert!(reachable.len() > 5, "the walk finds calls");
        for function in reachable {
            let named = FORBIDDEN.iter().find(|(part, _)| function.name.contains(part));
            let why = match named {
                Some((_, why)) => Some(*why),
                // RTIC saves and restores BASEPRI around the task itself.
                None if function == root => None,
                None if graph.masks_interrupts(function) => Some("masks interrupts"),
                None if graph.calls_indirectly(function) => Some("calls through a register"),
                None => None,
            };
            if let Some(why) = why {
                let chain: Vec<_> = graph
                    .chain(root, function)
                    .iter()
                    .map(|link| link.name.as_str())
                    .collect();
                broken.push(format!("{} {why}:\n    {}", function.name, chain.join("\n    ")));
            }
        }
    }
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

fn may_be_in_flash(function: &str) -> bool {
    let has_all = |parts: &&[&str]| parts.iter().all(|part| function.contains(part));
    IN_FLASH.iter().any(has_all)
}

/// Writes the patterns of all functions that a critical task reaches.
fn renew_itcm() {
    let image = nucleo();
    let graph = CallGraph::new(&image, &[PANIC]);
    let reached = CRITICAL.iter().flat_map(|name| graph.reachable(task(&image, name)));
    // A bridge between far memories is the linker's own.
    let own = reached.filter(|function| !function.name.contains("LongThunk") && !may_be_in_flash(&function.name));
    let patterns: BTreeSet<String> = own.map(|function| section_pattern(&function.name)).collect();
    let lines: String = patterns.iter().map(|pattern| format!("*({pattern});\n")).collect();
    let header = "/* What a critical task reaches. Written by tests/images.rs, which says how. */\n";
    std::fs::write(ITCM_LIST, format!("{header}{lines}")).expect("the list is written");
}

#[test]
fn code_and_data_of_the_critical_path_lie_in_tightly_coupled_memory() {
    if std::env::var_os(RENEW).is_some() {
        renew_itcm();
    }
    let image = nucleo();
    let graph = CallGraph::new(&image, &[PANIC]);
    let code = image.section(".itcm").expect("code in ITCM");
    let data = image.section(".dtcm").expect("data in DTCM");
    println!("{} bytes of code, {} bytes of data", code.size, data.size);
    let ends_in = |range: &Range<u32>, address: u32, size: u32| range.contains(&address) && address + size <= range.end;
    assert!(ends_in(&ITCM, code.address, code.size) && ends_in(&DTCM, data.address, data.size));
    let mut outside = Vec::new();
    for name in CRITICAL {
        for function in graph.reachable(task(&image, name)) {
            // A bridge from flash to ITCM lies beside its caller.
            let is_bridge = function.name.contains("LongThunk");
            if !ITCM.contains(&function.address) && !is_bridge && !may_be_in_flash(&function.name) {
                outside.push(function.name.as_str());
            }
        }
    }
    outside.sort_unstable();
    outside.dedup();
    assert!(
        outside.is_empty(),
        "not in ITCM ({RENEW}=1 renews the list):\n{}",
        outside.join("\n")
    );
    for part in CRITICAL_STATICS {
        let named = image.symbols().iter().find(|symbol| symbol.name.contains(part));
        let address = named.map(|symbol| symbol.address);
        assert!(
            address.is_some_and(|address| DTCM.contains(&address)),
            "{part}: {address:x?}"
        );
    }
    // All of it is written into the flash memory, from where the start copies the code.
    for load in image.loads() {
        assert!(ends_in(&FLASH, load.address, load.size), "{load:x?}");
    }
    assert!(
        image
            .function("__pre_init")
            .is_some_and(|start| FLASH.contains(&start.address))
    );
}

#[test]
fn the_log_lies_where_no_cache_is_and_never_waits_for_a_probe() {
    let image = nucleo();
    for part in LOG_STATICS {
        let named: Vec<_> = image
            .symbols()
            .iter()
            .filter(|symbol| symbol.name.contains(part))
            .collect();
        let [one] = named.as_slice() else {
            panic!("{part}: {named:?}")
        };
        assert!(
            DTCM.contains(&one.address) && DTCM.contains(&(one.address + one.size - 1)),
            "{one:x?}"
        );
    }
    let block = image.section(".rtt").expect("the log's control block");
    assert!(DTCM.contains(&block.address) && block.size > 0);
    // A waiting write would be inlined; the names of inlined functions are in the debug information.
    let bytes = std::fs::read(setup::build_firmware("nucleo").expect("the firmware is built")).expect("the image");
    let names = |name: &str| {
        bytes
            .windows(name.len())
            .filter(|text| *text == name.as_bytes())
            .count()
    };
    assert!(
        names("17nonblocking_write17h") > 0,
        "the debug information names what the log calls"
    );
    assert_eq!(
        names("14blocking_write17h"),
        0,
        "a log line waits until a debug probe reads"
    );
    for waits in [
        "_defmt_flush",
        "defmt_rtt..Logger$u20$as$u20$defmt..traits..Logger$GT$5flush",
    ] {
        assert!(
            image.functions().iter().all(|function| !function.name.contains(waits)),
            "{waits} waits"
        );
    }
}

#[test]
fn the_stack_of_every_priority_is_bounded_and_all_fit_their_memory() {
    let image = nucleo();
    let graph = CallGraph::new(&image, &[PANIC]);
    let bound = |function: &Function| match graph.stack(function) {
        StackBound::Bytes(bytes) => bytes,
        unbounded => panic!("{}: {unbounded:?}", function.name),
    };
    let mut sum = 0;
    for (priority, tasks) in NUCLEO_LEVELS {
        let mut deepest = 0;
        for name in tasks {
            // Some instruction reads like its address, which is a small number for what lies in ITCM.
            assert!(
                !graph.is_called_indirectly(task(&image, name)),
                "only the vector table has the address of {name}"
            );
            deepest = deepest.max(bound(task(&image, name)));
        }
        println!("priority {priority:2}: at most {deepest} bytes");
        sum += deepest + EXCEPTION_FRAME_BYTES;
    }
    let start = task(&image, "main");
    let panic = image.functions().iter().find(|function| function.name.contains(PANIC));
    let (start_up, panic) = (bound(start), bound(panic.expect("the panic handler")));
    println!("start-up, alone: at most {start_up} bytes; a panic, above all others: {panic}");
    sum += graph.frame(start) + panic;
    let size = |name: &str| image.section(name).map_or(0, |section| section.size);
    let data = size(".dtcm") + size(".rtt");
    println!("all nested: at most {sum} bytes, with {data} bytes of data, of {DTCM_BYTES_MAX}");
    assert!(sum + data <= DTCM_BYTES_MAX);
    assert!(start_up + panic + data <= DTCM_BYTES_MAX);
}
