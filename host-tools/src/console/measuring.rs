//! The firmware's histograms as shown on the page.
//!
//! They are read on request, in a separate thread, one piece after the other. Invariant: one reading at a time.

use super::Console;
use super::hub::{Level, Topic};
use crate::link::measurement::{Distribution, Reader, Readings};
use crate::machine::{Order, Reply};
use etherpen::measurement::{MeasurementRequest, Quantity, lower_bound};
use etherpen::messages::RecordAnswer;
use serde::Serialize;
use std::sync::Arc;
use std::sync::atomic::Ordering;

#[derive(Debug, Serialize)]
struct Bin {
    from_us: f64,
    to_us: f64,
    count: u32,
}

#[derive(Debug, Serialize)]
struct QuantityView {
    name: &'static str,
    count: u64,
    p50_us: f64,
    p999_us: f64,
    max_us: f64,
    bins: Vec<Bin>,
}

/// The measurements as shown on the page.
#[derive(Debug, Serialize)]
struct MeasuredView {
    quantities: Vec<QuantityView>,
    cpu_load: Option<f64>,
    text: &'static str,
}

fn name(quantity: Quantity) -> &'static str {
    match quantity {
        Quantity::ReleaseDelay => "jitter of the release",
        Quantity::Period => "period",
        Quantity::SendDelay => "release to telegram sent",
        Quantity::RoundTrip => "round trip",
        Quantity::TotalDelay => "release to reply served",
        Quantity::Sample => "execution of sample",
        Quantity::BusFrame => "execution of bus_frame",
        Quantity::BusDeadline => "execution of bus_deadline",
        Quantity::CriticalPath => "execution of all critical tasks",
        Quantity::Awake => "awake between two releases",
        Quantity::Trajectory => "execution of the planner",
        Quantity::Lateness => "output behind its deadline",
    }
}

fn view_of(quantity: Quantity, distribution: &Distribution) -> QuantityView {
    let us = |counts: u32| f64::from(counts) * 1e6 / f64::from(distribution.counts_per_s);
    let bin = |(bin, count): &(u8, u32)| Bin {
        from_us: us(lower_bound(usize::from(*bin))),
        to_us: us(lower_bound(usize::from(*bin) + 1)),
        count: *count,
    };
    QuantityView {
        name: name(quantity),
        count: distribution.count(),
        p50_us: us(distribution.quantile(0.5)),
        p999_us: us(distribution.quantile(0.999)),
        max_us: us(distribution.largest),
        bins: distribution.bins.iter().map(bin).collect(),
    }
}

fn view(readings: &Readings) -> MeasuredView {
    let read = |quantity: &Quantity| readings.of(*quantity).map(|read| view_of(*quantity, read));
    MeasuredView {
        quantities: Quantity::ALL.iter().filter_map(read).collect(),
        cpu_load: readings.cpu_load(),
        text: "This firmware has measured nothing: in virtual time nothing takes any time. The emulated one has.",
    }
}

impl Console {
    /// Reads the firmware's measurements, or resets them.
    pub(super) fn measure(self: &Arc<Self>, reset: bool) {
        if reset {
            return self.order(
                self.ticket(),
                "measuring again from zero",
                Order::Measure(MeasurementRequest::Reset.into()),
            );
        }
        if self.measuring.swap(true, Ordering::Relaxed) {
            return;
        }
        let console = self.clone();
        let spawned = std::thread::Builder::new().name("measuring".to_owned()).spawn(move || {
            console.read();
            console.measuring.store(false, Ordering::Relaxed);
        });
        if spawned.is_err() {
            self.measuring.store(false, Ordering::Relaxed);
        }
    }

    fn read(&self) {
        let mut reader = Reader::new();
        while let Some(request) = reader.request() {
            match self.machine.carry_out(Order::Measure(request.into())) {
                Ok(Reply::Measured(RecordAnswer::Measurement(answer))) => reader.take(&answer),
                Ok(_) => return,
                Err(failure) => {
                    return self.change(|hub| hub.note(Level::Warning, format!("measurements: {failure}")));
                }
            }
        }
        if let Some(readings) = reader.into_readings() {
            self.change(|hub| hub.say(Topic::Measured, &view(&readings)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use etherpen::measurement::Measurements;

    #[test]
    fn histograms_are_told_in_microseconds_and_those_without_values_not_at_all() {
        let measurements = Measurements::new();
        measurements.set_counts_per_s(25_000_000);
        (0..1_000).for_each(|_| measurements.record(Quantity::RoundTrip, 1_250));
        let mut reader = Reader::new();
        while let Some(request) = reader.request() {
            reader.take(&measurements.answer(request));
        }
        let view = view(&reader.into_readings().unwrap());
        let [round_trip] = &view.quantities[..] else {
            panic!("{view:?}")
        };
        assert_eq!(
            (round_trip.name, round_trip.count, round_trip.max_us),
            ("round trip", 1_000, 50.0)
        );
        assert!(
            round_trip
                .bins
                .iter()
                .all(|bin| bin.from_us <= 50.0 && bin.to_us > 50.0)
        );
    }
}
