//! The short drawing by the firmware's tasks in virtual time, without the emulator.

mod golden;

#[test]
fn the_drawing_in_virtual_time_is_clean_and_the_golden_one() {
    let (prepared, task) = golden::strokes();
    let drawn = host_tools::run::simulate(&task, None, &mut |_| {}).expect("nothing is captured");
    let report = golden::assert_clean(&prepared, &task, &drawn);
    golden::compare(&task, &drawn, &report);
}
