//! The tests of faults again, with distributed clocks.

use crate::again::left_out;

again! {
    main [crate]
        a_stop_ends_in_a_latched_standstill_and_is_recovered,
        a_drive_fault_stops_all_axes_names_the_axis_and_is_reset,
        a_lost_slave_stops_the_others_and_is_brought_back_after_the_acknowledgement,
        stalled_frames_stop_the_motors_by_the_drives_own_watchdog,
        motors_that_stop_answering_are_stopped_by_the_quick_stop_that_still_arrives,
        a_repeated_stop_does_not_keep_the_robot_stopping,
        a_stop_before_any_configuration_is_acknowledged,
        a_slave_that_leaves_op_is_named_with_its_al_code,
        a_power_cycled_drive_comes_back_without_its_reference,
        nothing_moves_before_the_reference_and_a_known_pose_gives_it,
        a_frozen_resolver_is_a_deviation_of_the_feedback_with_axis_and_limit,
        single_bad_frames_cost_one_cycle_each_and_the_drawing_goes_on,
        a_held_drawing_is_the_same_drawing,
        a_hold_before_the_path_has_come_lets_nothing_move_until_resume,
        cancel_lifts_the_pen_and_forgets_the_rest,
        a_silent_host_leads_to_holding_and_only_resume_moves_again,
        half_speed_takes_longer_and_is_reported,
        a_jog_ends_without_its_dead_man_message,
        targets_outside_the_work_area_are_refused_before_anything_moves,
        a_vertex_outside_the_work_area_is_refused_with_its_index,
        power_is_taken_only_from_a_robot_that_stands_with_its_brakes_closed,
        enabling_far_from_the_last_reference_is_without_a_bump;
    akd [crate::akd]
        akd_drives_draw_what_other_drives_in_position_mode_draw_also_with_targets_lost,
        drives_enabled_elsewhere_than_at_their_last_target_do_not_move,
        whatever_an_akd_forgets_it_is_told_again_and_the_next_drawing_comes_out_right,
        a_drive_without_a_position_mode_is_refused_by_name_and_nothing_moves;
    axes [crate::axes]
        a_robot_without_its_fourth_axis_draws_the_same_lines,
        faults_of_a_robot_without_its_fourth_axis_are_told_as_with_it_and_it_comes_back;
    board [crate::board]
        an_open_emergency_stop_is_a_quick_stop_that_no_acknowledgement_ends,
        a_pulse_on_the_emergency_stop_wire_stops_nothing,
        an_open_emergency_stop_while_another_fault_is_latched_keeps_it_latched,
        an_emergency_stop_that_is_open_from_the_start_is_acknowledged_once_it_is_closed,
        a_pulled_cable_is_told_as_such_and_the_bus_comes_back_with_it,
        a_board_without_link_at_the_start_waits_for_it_and_then_says_so,
        a_failed_clock_stops_the_drives_and_nothing_moves_on_its_substitute,
        a_trajectory_task_that_is_late_by_most_of_its_period_costs_nothing,
        a_trajectory_task_that_hangs_in_motion_is_a_quick_stop,
        bytes_that_the_serial_port_overruns_are_sent_again_and_the_drawing_is_the_same,
        errors_of_the_ethernet_dma_are_told_and_a_drawing_survives_the_frames_that_they_cost;
    commands [crate::commands]
        whatever_was_pressed_at_once_the_robot_draws_afterwards,
        a_reference_and_a_motion_at_once_never_leave_the_robot_moving;
    feedback [crate::feedback]
        after_a_frozen_feedback_the_next_drawing_comes_out_right;
    homing [crate::homing]
        a_gantry_finds_its_switches_from_wherever_it_stands_and_never_touches_an_end_stop,
        an_axis_that_stands_at_its_switch_leaves_it_first,
        each_failure_of_a_switch_ends_at_standstill_with_its_cause_and_the_machine_comes_back,
        a_search_ends_at_a_stop_a_lost_terminal_a_lost_drive_and_a_silent_host,
        a_search_that_is_ended_early_leaves_a_homed_machine_unhomed_where_it_stands,
        a_search_of_two_belts_fails_as_any_other_and_the_machine_comes_back,
        a_way_that_is_too_short_ends_the_search_before_the_end_stop,
        two_belts_find_the_switches_of_both_slides_from_wherever_they_stand;
    io [crate::io]
        an_open_stop_or_door_is_a_quick_stop_at_once_at_any_speed_and_heals,
        without_power_an_open_door_keeps_it_away_and_an_open_stop_is_a_fault,
        a_lost_terminal_with_a_stop_stops_the_robot_and_comes_back_after_the_acknowledgement,
        a_cut_cable_names_the_slave_that_was_lost_before_the_inputs_that_depend_on_it,
        an_output_with_two_names_is_refused_with_both_and_stays_off,
        a_terminal_that_stays_lost_refuses_the_acknowledgement_with_its_name,
        a_terminal_without_a_stop_is_reported_and_disturbs_no_drawing,
        a_spare_drive_as_a_terminal_shows_its_objects_and_disturbs_no_drawing_in_any_state,
        a_drive_behind_terminals_is_named_by_its_place,
        outputs_are_set_when_the_mode_allows_and_fall_to_their_safe_state_at_a_fault,
        a_stop_over_the_link_and_a_lost_drive_switch_the_outputs_off_too,
        an_open_hold_holds_the_drawing_and_start_resumes_it,
        start_switches_the_drives_on_only_when_it_closes,
        the_lamp_shows_every_mode,
        a_configuration_with_a_wrong_point_is_refused_with_its_reason,
        terminals_at_each_others_places_are_refused_with_both_and_draw_when_they_are_put_back,
        a_terminal_of_another_product_than_expected_is_refused_and_the_right_one_is_taken_in_its_place;
    io_samples [crate::io_samples]
        an_input_and_an_output_are_in_the_sample_of_the_millisecond_in_which_they_change,
        a_terminal_that_is_lost_is_missing_in_the_samples_and_a_word_shows_whether_it_is_0;
    io_words [crate::io_words]
        analogue_inputs_and_outputs_are_in_the_sample_of_the_millisecond_in_which_they_change,
        words_of_a_terminal_that_is_lost_have_no_value_and_are_back_with_it;
    limits [crate::limits]
        a_limit_switch_that_opens_while_drawing_stops_the_motors_and_names_its_axis,
        a_terminal_of_limit_switches_that_fails_is_a_fault,
        homing_takes_no_notice_of_limit_switches_and_motion_after_it_does;
    encoder_turns [crate::encoder_turns]
        multi_turn_encoders_show_where_the_machine_was_pushed_and_others_do_not,
        a_machine_pushed_by_turns_draws_where_it_should_with_multi_turn_encoders,
        a_pose_a_turn_away_from_what_a_multi_turn_encoder_shows_is_refused_and_an_incremental_one_takes_any,
        a_position_that_starts_again_after_a_turn_is_not_believed_to_be_multi_turn;
    other_side [crate::other_side]
        a_joint_pushed_to_the_other_side_is_told_and_the_robot_works_again_once_it_is_pushed_back;
    outside [crate::outside]
        from_outside_the_work_area_the_robot_is_jogged_in_and_nowhere_else,
        a_move_brings_the_robot_in_from_outside_the_work_area;
    path_stop [crate::path_stop]
        a_stop_twice_while_held_while_braking_for_a_hold_and_in_single_motions_is_one_stop,
        a_fault_in_a_stop_on_the_path_is_a_quick_stop_as_soon_as_in_a_drawing,
        a_stop_while_the_axes_are_led_to_their_switches_is_the_quick_stop;
    path_stop_left [crate::path_stop_left]
        a_stop_that_leaves_its_path_is_a_quick_stop_that_names_the_axis_and_the_part_of_the_envelope,
        a_stop_that_keeps_its_path_is_not_counted_as_one_that_left_it;
    pen_output [crate::pen_output]
        a_terminal_that_fails_while_its_pen_draws_is_a_fault_and_a_held_drawing_has_its_pen_up,
        the_pen_is_up_until_the_machine_is_homed_in_a_search_and_on_the_way_down_to_the_sheet,
        a_way_down_that_ends_above_the_paper_is_travel_and_leaves_no_ink,
        a_tool_that_nothing_lifts_touches_always_and_draws_its_travel_too;
    pen_servo [crate::pen_servo]
        ink_begins_and_ends_with_the_line_at_a_servos_speed,
        the_servo_lifts_the_pen_at_every_stop_and_keeps_it_up_when_power_comes_back,
        a_hold_lifts_the_servos_pen_and_its_terminals_failure_is_a_fault;
    pen_ways [crate::pen_ways]
        a_move_leaves_the_paper_straight_up_goes_over_the_sheet_and_comes_straight_down,
        a_path_that_begins_on_the_sheet_is_approached_from_above_with_the_pen_up;
    position [crate::position]
        enabling_and_holding_moves_no_joint_and_a_pushed_target_is_not_taken_over,
        single_lost_targets_leave_no_trace_because_the_drives_extrapolate,
        three_lost_targets_in_a_row_let_the_drives_stand_for_a_moment_and_the_drawing_goes_on,
        a_stop_and_a_hold_end_at_rest_with_the_targets_where_the_motors_are,
        drives_that_count_one_turn_draw_across_its_end_as_those_that_count_all_turns,
        drives_that_hold_at_the_end_of_their_turn_stay_there_whatever_is_missing,
        a_drive_that_does_not_tell_that_it_counts_one_turn_stops_the_robot_at_its_end,
        a_drive_replaced_by_another_of_its_kind_is_homed_and_draws;
    tool [crate::tool]
        the_laser_is_off_outside_strokes_and_the_whole_of_each_stroke_has_light,
        the_way_to_a_path_that_begins_with_the_pen_down_is_dark,
        a_dispenser_gets_a_pulse_for_each_pitch_of_each_stroke;
    tool_stops [crate::tool_stops]
        the_light_is_off_in_the_millisecond_in_which_a_stop_a_hold_or_a_fault_arrives,
        a_hold_is_dark_before_the_tool_brakes_and_the_line_goes_on_after_a_known_gap_or_none,
        after_a_stop_the_light_stays_off_until_the_next_stroke_which_is_whole;
    unreferenced [crate::unreferenced]
        feedback_that_cannot_be_true_is_a_fault_without_a_reference_too;
}

/// Tests of these modules that run without clocks only, and why.
const WITHOUT: [(&str, &str); 11] = [
    (
        "a_configuration_is_needed_checked_and_kept",
        "it compares configurations, to which the clocks belong",
    ),
    (
        "the_emulated_board_stops_for_its_emergency_stop_input_and_for_its_clock_and_recovers",
        "the emulator takes long",
    ),
    (
        "a_limit_switch_without_an_axis_of_the_machine_is_refused",
        "it checks configurations and runs no robot",
    ),
    (
        "the_table_of_the_stops_is_that_of_the_documentation",
        "it measures a table of the usual configuration",
    ),
    (
        "a_stop_anywhere_on_a_drawing_keeps_its_path_in_each_mode_of_the_drives",
        "it scans a hundred stops, and the stops with faults of the same module run with clocks",
    ),
    (
        "the_pen_is_off_at_once_at_a_stop_a_drive_fault_and_a_lost_terminal_and_stays_up_when_power_comes_back",
        "it takes long, and the faults are those of io, which run with clocks",
    ),
    (
        "a_pen_whose_way_is_cancelled_at_any_millisecond_is_up_and_leaves_no_ink_elsewhere",
        "it scans every millisecond, and the setpoints do not depend on clocks",
    ),
    (
        "a_pen_whose_way_up_is_cancelled_is_up",
        "it scans every millisecond, and the setpoints do not depend on clocks",
    ),
    (
        "a_drawing_held_on_the_way_down_has_its_pen_up_and_then_draws_its_whole_line",
        "it scans every millisecond, and the setpoints do not depend on clocks",
    ),
    (
        "whatever_stops_the_robot_in_position_mode_the_next_drawing_comes_out_right",
        "it takes minutes, and the faults are those of other modules, which run with clocks",
    ),
    (
        "the_word_follows_the_true_speed_at_corners_starts_and_ends_at_every_override",
        "it takes long, and the setpoints do not depend on clocks",
    ),
];

const CHOOSES: &str = "its tests choose for themselves";
const USUAL: &str = "its figures belong to the usual configuration";
const NO_TESTS: &str = "it has no tests of its own";

/// Modules that run without clocks only, or not from here, and why.
const MODULES_WITHOUT: [(&str, &str); 13] = [
    ("again", NO_TESTS),
    ("bursts", CHOOSES),
    ("clocks", "it runs the others"),
    ("dense", "it has no fault and looks at the link"),
    ("feedback_scan", USUAL),
    ("feedback_soak", USUAL),
    ("identity", CHOOSES),
    ("liveness", CHOOSES),
    ("matrix", "a third of its cells run with clocks in it"),
    ("outputs", CHOOSES),
    ("robot", NO_TESTS),
    ("stale", CHOOSES),
    ("true_times", NO_TESTS),
];

#[test]
fn every_module_of_tests_runs_with_clocks_too_or_says_why_not() {
    let lines = include_str!("main.rs").lines();
    let modules = lines.filter_map(|line| line.strip_prefix("mod ")?.strip_suffix(';'));
    let is_listed = |module: &&str| AGAIN.iter().any(|(listed, _, _)| listed == module);
    let without: Vec<_> = modules.filter(|module| !is_listed(module)).collect();
    assert_eq!(without, MODULES_WITHOUT.map(|(module, _)| module));
}

#[test]
fn every_test_of_faults_runs_with_clocks_too_or_says_why_not() {
    let mut found = Vec::new();
    for (_, source, listed) in AGAIN {
        found.extend(left_out(source, listed));
    }
    assert_eq!(found, WITHOUT.map(|(test, _)| test));
}
