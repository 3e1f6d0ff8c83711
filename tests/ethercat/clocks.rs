//! The tests of faults again, with distributed clocks.

use crate::again::left_out;

again! {
    bring_up [crate::bring_up]
        four_drives_reach_op_enable_and_follow_their_demands,
        four_drives_do_the_same_when_inputs_and_outputs_are_exchanged_together,
        a_plan_is_adopted_once_and_not_in_every_cycle,
        a_quick_stop_brakes_with_the_ramp_that_was_written,
        a_drive_fault_is_seen_in_the_status_word_and_reset_by_an_edge,
        disturbed_frames_delay_the_bring_up_and_cost_single_cycles,
        a_slave_that_leaves_op_is_reported_with_its_code_and_repaired_while_the_others_go_on,
        a_bus_that_stood_still_falls_to_the_watchdog_and_is_recovered,
        a_power_cycled_slave_comes_back_without_a_reference,
        a_pulled_cable_is_reported_for_every_slave_behind_it_and_healed,
        a_bypassed_slave_is_reported_and_taken_back,
        a_mailbox_that_stays_silent_is_a_refusal_and_a_second_try_succeeds,
        a_slave_that_falls_to_any_state_is_repaired_in_either_exchange;
    frame_faults [crate::frame_faults]
        a_few_disturbed_frames_at_any_stage_of_the_bring_up_delay_it_only,
        many_disturbed_frames_at_any_stage_of_the_bring_up_are_survived_or_refused_and_the_next_try_succeeds,
        a_mailbox_message_lost_on_its_way_is_given_again_and_its_request_is_not_sent_again,
        a_message_that_a_slave_cannot_give_again_is_a_timeout_and_the_next_try_succeeds,
        a_frame_fault_in_op_costs_one_cycle_of_its_telegram_and_nothing_else,
        inputs_that_come_with_the_reply_to_the_outputs_are_too_late_for_their_cycle_only,
        an_sdo_is_carried_out_once_whatever_happens_to_the_frames_meanwhile,
        a_second_master_finds_a_mailbox_in_use_and_is_answered_at_once_or_after_a_moment;
    slave_faults [crate::slave_faults]
        a_refused_state_is_reported_with_its_code_even_0_and_reached_at_the_next_try,
        a_slave_that_falls_back_in_op_with_any_code_is_named_and_repaired_and_disturbs_no_other,
        a_slave_that_falls_back_during_the_bring_up_ends_it_and_the_next_try_succeeds,
        an_information_memory_that_fails_is_named_and_one_that_is_whole_again_is_read,
        a_mailbox_fault_at_any_step_of_the_bring_up_is_overcome_or_named_and_the_next_try_succeeds,
        a_mailbox_fault_in_op_reaches_the_asker_or_is_overcome_and_costs_no_cyclic_data,
        slaves_and_cables_that_go_and_come_are_noticed_in_time_and_taken_back,
        a_slave_that_is_replaced_during_repairs_while_those_behind_it_are_away_takes_its_own_place,
        a_slave_that_returns_while_another_is_identified_at_its_place_loses_nothing,
        a_slave_that_returns_before_one_that_is_being_identified_costs_no_other_its_address,
        another_product_in_a_slaves_place_is_refused_until_the_right_one_is_back,
        a_coupler_that_nobody_uses_is_recognised_after_a_loss_of_its_power_at_any_time,
        an_extra_slave_is_reported_and_gets_no_process_data,
        a_cable_that_destroys_frames_costs_these_frames_and_is_named_by_its_ends,
        a_slave_whose_processor_hangs_costs_the_others_nothing_and_is_usable_again,
        a_drive_that_only_its_device_type_tells_is_replaced_by_one_with_another_serial_number;
    services [crate::services]
        without_a_bus_the_slaves_are_found_and_identified_and_nothing_is_configured,
        without_a_bus_an_sdo_brings_its_slave_to_preop_and_no_other,
        registers_and_information_are_read_in_pieces,
        an_sdo_in_operation_disturbs_no_cyclic_data,
        switches_are_asked_for_in_init_and_preop_and_never_in_operation,
        an_abort_reaches_the_asker_with_object_and_code,
        a_slave_left_in_preop_is_left_alone_until_it_is_asked_up_again_or_the_bus_is_repaired,
        a_slave_that_is_asked_out_of_op_and_back_is_no_disturbance,
        a_slave_without_an_axis_gets_process_data_with_which_it_stays_in_op,
        a_slave_that_falls_while_another_answers_slowly_is_noticed_within_100_ms,
        a_slave_lost_during_the_repair_of_another_is_noticed_within_100_ms_and_both_come_back,
        a_stop_sends_safe_outputs_first_and_ends_in_init,
        requests_while_the_bus_is_brought_up_are_answered_by_busy,
        error_counters_name_the_slaves_at_both_ends_of_a_cable,
        a_slave_without_a_driver_gets_the_sync_managers_that_it_describes_and_goes_to_op,
        error_counters_read_again_and_again_postpone_no_bring_up_and_work_on_a_slave_does,
        drives_that_requests_put_in_op_on_a_failed_bus_are_no_bus_in_operation_and_are_shut_down_at_the_next_start;
    disturbances [crate::disturbances]
        an_unused_slave_with_an_error_keeps_no_drive_from_operation,
        a_terminal_that_falls_during_the_bring_up_is_named_alone_and_comes_back,
        a_terminal_that_loses_its_power_during_the_bring_up_keeps_no_drive_from_operation,
        a_drive_that_leaves_its_state_during_the_bring_up_is_named_and_the_next_try_comes_unasked,
        the_drives_exchange_data_soon_after_safeop_and_operate_before_a_terminal_is_configured,
        a_stop_while_a_terminal_starts_up_takes_the_drives_out_of_operation,
        a_new_setup_while_a_terminal_starts_up_begins_in_init,
        a_drive_that_falls_while_a_terminal_starts_up_is_named_and_all_begin_anew,
        a_drive_that_is_lost_while_a_terminal_starts_up_comes_back_unasked,
        a_terminal_that_lost_its_power_is_told_when_it_is_back,
        two_equal_terminals_that_lost_their_power_are_both_told_when_they_are_back,
        a_stop_at_any_moment_of_the_bring_up_leaves_no_drive_in_operation,
        a_drive_that_is_lost_for_good_during_the_bring_up_leaves_no_other_in_operation,
        a_link_that_is_away_for_a_moment_during_the_bring_up_costs_nothing_for_ever,
        a_loose_contact_of_an_unused_slave_takes_no_drive_out_of_operation;
    files [crate::files]
        a_file_of_any_length_is_read_as_it_was_written_packet_by_packet,
        after_boot_objects_are_read_also_where_another_master_has_brought_the_drive_to_preop,
        an_acknowledgement_leaves_a_drive_in_boot_and_repairs_it_after_the_transfer,
        another_drive_is_repaired_while_one_is_in_boot,
        a_file_that_nobody_asks_for_in_10_s_protects_its_drive_no_more,
        a_new_configuration_leaves_a_drive_in_boot_and_takes_the_others_out_of_operation,
        a_failed_bus_is_brought_up_after_the_transfer_whatever_is_plugged_meanwhile,
        a_stop_leaves_a_drive_in_boot,
        a_file_left_open_in_boot_is_closed_by_the_next_request_that_needs_the_mailbox,
        a_new_configuration_waits_for_a_packet_over_which_the_drive_takes_longer_than_a_file_may_lie_idle;
    diagnosis [crate::diagnosis]
        a_damaged_cable_is_reported_with_the_slaves_at_its_ends,
        an_emergency_is_fetched_reported_and_kept_for_who_asks;
    returned [crate::returned]
        a_memory_that_is_damaged_for_a_moment_of_a_repair_is_read_again_by_the_next,
        an_extra_drive_takes_no_axis_whose_own_drive_is_back;
    terminals [crate::terminals]
        a_terminal_exchanges_its_data_in_however_many_sync_managers_they_are,
        a_terminal_with_data_in_too_many_sync_managers_is_refused_and_the_drives_operate,
        terminals_of_any_chain_exchange_their_bits_beside_the_drives,
        a_terminal_that_fails_disturbs_no_drive_and_comes_back_on_command,
        a_terminal_that_cannot_be_read_is_refused_and_the_drives_operate,
        a_terminal_that_lost_power_with_a_damaged_memory_comes_back_once_it_is_whole,
        a_terminal_whose_description_is_damaged_during_its_repair_is_refused_until_it_is_whole,
        a_refused_terminal_that_is_brought_to_op_by_a_request_is_read_again,
        a_refused_terminal_and_its_neighbour_that_returns_first_are_not_taken_for_each_other,
        a_terminal_that_was_too_slow_to_be_identified_comes_back_after_a_power_loss,
        a_chain_whose_length_is_told_waits_for_a_missing_slave_that_nobody_names,
        a_chain_in_which_a_named_place_may_be_another_slave_waits_for_the_missing_one,
        outputs_become_0_when_the_bus_is_stopped_and_values_are_found_by_their_objects,
        a_drive_that_is_named_as_a_terminal_is_no_axis_wherever_it_is;
    homing [crate::homing]
        an_index_pulse_and_the_present_place_become_the_home_position,
        a_search_without_an_end_is_timed_out_and_a_fault_ends_it_at_rest,
        a_touch_probe_stores_the_place_of_the_next_index_pulse_each_time_it_is_armed;
    axes [crate::axes]
        drives_move_whichever_of_their_sync_managers_carry_the_process_data,
        drives_of_one_product_come_up_and_come_back_each_with_its_own_sync_managers,
        axes_beyond_one_frame_go_to_their_targets_at_their_limit_of_speed_whatever_the_cycle;
    odd_controllers [crate::odd_controllers]
        a_slave_without_lrw_exchanges_its_data_by_lrd_and_lwr_in_any_chain,
        a_slave_without_lrw_that_replaces_one_with_it_ends_the_combined_exchange_at_its_repair,
        a_slave_without_lrw_that_was_away_at_the_bring_up_is_used_from_the_next_one_on,
        stale_units_of_a_large_controller_that_takes_no_blocks_of_them_are_cleared;
    other_masters [crate::other_masters]
        a_slave_that_is_plugged_in_with_power_loses_what_another_master_has_left_in_it,
        another_product_that_has_the_address_of_a_lost_slave_is_refused_until_the_right_one_is_back,
        the_address_of_a_lost_slave_at_another_place_is_taken_away_and_the_right_one_comes_back,
        an_equal_device_with_the_address_of_a_lost_one_is_configured_anew,
        all_units_of_a_slave_that_comes_with_the_address_of_another_are_cleared;
    own_driver [crate::own_driver]
        members_with_inputs_or_outputs_only_operate_on_slaves_that_refuse_an_empty_sync_manager;
    real_chain [crate::real_chain]
        the_robots_drives_operate_among_eight_other_devices_in_any_order,
        the_robots_drives_operate_among_eight_real_memories_in_any_order,
        no_damaged_memory_of_an_unused_slave_keeps_the_drives_from_operating,
        what_can_come_up_comes_up_while_the_drives_run,
        what_can_come_up_of_eight_real_memories_comes_up_while_the_drives_run,
        the_descriptions_say_what_the_dumps_hold;
    without_drivers [crate::without_drivers]
        drives_are_exchanged_by_the_objects_that_they_list_and_terminals_by_their_memory,
        any_cycle_time_from_250_us_to_10_ms_brings_a_chain_up_exchanges_and_repairs_it,
        chosen_process_data_are_assigned_mapped_and_found_where_they_lie,
        what_another_master_left_in_ports_and_aliases_hides_no_slave,
        a_supervisor_with_a_clock_waits_as_long_however_often_it_is_polled,
        a_chain_that_goes_off_as_a_whole_is_not_reported_in_operation_and_comes_up_unasked;
}

/// Modules whose tests do not run from here, and why.
const MODULES_WITHOUT: [(&str, &str); 6] = [
    ("again", "it has no tests of its own"),
    ("bench", "it has no tests of its own"),
    ("clocks", "it runs the others"),
    ("device_images", "it has no tests of its own"),
    ("rig", "it has no tests of its own"),
    ("several_frames", "its tests choose for themselves"),
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
fn every_test_of_faults_runs_with_clocks_too() {
    for (module, source, listed) in AGAIN {
        assert_eq!(left_out(source, listed), [""; 0], "{module}");
    }
}
