//! Requirements on the model of an axis in torque mode that need no plant.

use super::*;

/// Digits for an N m.
const DIGITS_PER_NM: f64 = 390.0;

fn model(axis: &Axis) -> TorqueModel {
    TorqueModel::new(axis, DIGITS_PER_NM)
}

#[test]
fn each_axis_is_told_its_own_demand_the_others_and_the_greatest() {
    let (now, next) = ([0.5, -2.0, 1.0, 0.0], [0.51, -2.03, 1.0, 0.004]);
    let demanded = Demanded::between([&now, &next]);
    let close = |value: f32, expected: f64| (f64::from(value) - expected).abs() < 1.0e-3;
    for axis in &demanded {
        assert!(
            close(axis.greatest_rad_s, 2.0) && close(axis.greatest_rad_s2, 30.0),
            "{axis:?}"
        );
    }
    let own = [(0.5, 10.0), (-2.0, -30.0), (1.0, 0.0), (0.0, 4.0)];
    let others = [34.0, 14.0, 44.0, 40.0];
    for ((axis, (rad_s, rad_s2)), others) in demanded.iter().zip(own).zip(others) {
        assert!(
            close(axis.own_rad_s, rad_s) && close(axis.own_rad_s2, rad_s2),
            "{axis:?}"
        );
        assert!(close(axis.others_rad_s2, others), "{axis:?}");
    }
}

#[test]
fn what_was_unknown_when_a_drive_took_its_power_is_forgotten_at_rest() {
    let mut model = model(&Axis::default());
    let limit = |model: &TorqueModel| model.pushed.limit;
    model.expect(0.0);
    assert!(model.follows(0.0));
    let enabled = limit(&model);
    for _ in 0..20_000 {
        model.expect(0.0);
        assert!(model.follows(0.0));
    }
    let friction = FRICTION_RAD_S2 * STEP_S2;
    assert!(enabled > friction + 1.9 * ENABLING_RAD_S2 * STEP_S2, "{enabled}");
    assert!(
        limit(&model) < friction + 0.1 * ENABLING_RAD_S2 * STEP_S2,
        "{}",
        limit(&model)
    );
}

#[test]
fn an_axis_without_an_inertia_has_limits_that_are_numbers() {
    let axis = Axis {
        inertia_kg_m2: 0.0,
        ..Axis::default()
    };
    let mut model = model(&axis);
    for _ in 0..100 {
        assert!(model.expect(100.0).is_finite());
        model.follows(0.0);
        assert!(model.used().iter().all(|used| used.is_finite()), "{:?}", model.used());
    }
}

#[test]
fn a_constant_torque_moves_the_model_with_the_square_of_time() {
    let axis = Axis::default();
    let mut model = model(&axis);
    let (torque_nm, time_s) = (1.5, 0.2);
    let moved_rad: f64 = (0..200)
        .map(|_| f64::from(model.expect((torque_nm * DIGITS_PER_NM) as f32)))
        .sum();
    // The command arrives later by the delays of the drive.
    let delay_s = (axis.torque_lead_ms + axis.measurement_age_ms) * STEP_S;
    let expected_rad = |time_s: f64| 0.5 * torque_nm / axis.inertia_kg_m2 * time_s * time_s;
    let between = expected_rad(time_s - 2.0 * delay_s)..expected_rad(time_s);
    assert!(between.contains(&moved_rad), "{moved_rad} rad, not {between:?}");
}

#[test]
fn a_setpoint_that_leads_away_from_a_position_at_rest_is_not_followed() {
    let mut model = model(&Axis::default());
    // Long after the drive took its power.
    for _ in 0..5_000 {
        model.expect(0.0);
        assert!(model.follows(0.0));
    }
    let moving = Demanded {
        own_rad_s: -0.2,
        greatest_rad_s: 0.2,
        ..Demanded::default()
    };
    model.set_demanded(&moving);
    let limit_rad = Following::of(&Axis::default(), Axis::default().inertia_kg_m2).base_rad;
    let refused_ms = (1..=500).find(|_| {
        model.expect(0.0);
        !model.follows(0.0)
    });
    let led_rad = refused_ms.map(|ms| ms as f32 * 0.2e-3);
    assert!(
        led_rad.is_some_and(|led_rad| led_rad > limit_rad && led_rad < 5.0 * limit_rad),
        "{led_rad:?} rad of {limit_rad}"
    );
    let [value, limit] = model.broken().unwrap();
    assert_eq!(value, model.stuck.value, "another comparison: {value} of {limit}");
    // An axis that is to rest has nothing to follow.
    model.set_demanded(&Demanded::default());
    model.expect(0.0);
    assert!(model.follows(0.0), "{:?}", model.used());
}

#[test]
fn a_position_that_stays_is_found_soon_however_fast_the_axes_accelerate() {
    let axis = Axis::default();
    for greatest_rad_s2 in [200.0, 600.0, 2_000.0] {
        let mut model = model(&axis);
        let moving = Demanded {
            own_rad_s: 2.0,
            greatest_rad_s: 2.0,
            greatest_rad_s2,
            ..Demanded::default()
        };
        model.set_demanded(&moving);
        let refused_ms = (1..=500).find(|_| {
            model.expect(0.0);
            !model.follows(0.0)
        });
        let led_rad = f64::from(moving.own_rad_s) * STEP_S * f64::from(refused_ms.unwrap_or(500));
        // The limit of the deviation, two fifths of it, and what the delays of the drive take.
        let delays_ms = axis.torque_lead_ms + axis.measurement_age_ms + 0.5;
        let most_rad = 1.4 * axis.feedback_deviation_max_rad + delays_ms * STEP_S * f64::from(moving.own_rad_s);
        let step_rad = STEP_S * f64::from(moving.own_rad_s);
        assert!(
            (most_rad - step_rad..most_rad + 2.0 * step_rad).contains(&led_rad),
            "{greatest_rad_s2} rad/s2: after {led_rad} rad, not {most_rad}"
        );
        let [value, limit] = model.broken().expect("a comparison");
        assert_eq!(value, model.stuck.value, "another comparison: {value} of {limit}");
    }
}
