//! Who gives the time when the clock that distributed its time has gone.

use super::*;

/// A chain whose clocks were set up; then the time of the first went on without the others for a while.
struct Alone {
    chain: Chain,
    clocks: BusClocks<16>,
    /// The chain's time when the last port began to count its milliseconds.
    begun_ns: u64,
}

impl Alone {
    fn new(slaves: &[usize]) -> Self {
        let mut chain = Chain::new([(WIDE, 5, 0), (NARROW, 1 << 40, 0), (WIDE, 42, 0), (WIDE, 123_456, 0)]);
        let begun_ns = chain.true_ns;
        let mut clocks = chain.set_up();
        for slave in slaves {
            clocks.was_alone(*slave);
        }
        Self {
            chain,
            clocks,
            begun_ns,
        }
    }

    /// Does a step with the master's own time where it was: each port counts its milliseconds from 0.
    fn run<T>(&mut self, step: impl AsyncFnOnce(AcyclicPort<'static, 64>, &mut BusClocks<16>) -> T) -> T {
        let passed_ms = (self.chain.true_ns - self.begun_ns) / u64::from(PERIOD_NS);
        self.begun_ns = self.chain.true_ns;
        self.clocks.read_ms = self.clocks.read_ms.wrapping_sub(passed_ms as u32);
        let clocks = &mut self.clocks;
        self.chain
            .run(async |port: AcyclicPort<'static, 64>| step(port, clocks).await)
    }

    /// The time of the bus goes on for so long, and the master follows it; those who are lost are without it.
    fn follow(&mut self, wait_ms: u32, lost: &[usize]) {
        self.run(async |mut port, clocks| {
            port.wait_ms(wait_ms).await;
            follow(&mut port, &STATIONS, clocks, |place| !lost.contains(&place)).await;
        });
    }

    /// Looks for a distributor after a while; returns its place.
    fn find(&mut self, wait_ms: u32, lost: &[usize]) -> Option<usize> {
        let answers = |place: usize| !lost.contains(&place);
        let is_found = self.run(async |mut port, clocks| {
            port.wait_ms(wait_ms).await;
            find_source(&mut port, &STATIONS, clocks, answers).await
        });
        let distributor = self.clocks.distributor(answers);
        assert_eq!(distributor.is_some(), is_found);
        distributor
    }

    /// Sets the clock of the first slave, which was off; returns how far it is then from the time of the bus as it would have gone
    /// on, and from that of the others, ns.
    fn restore_first(&mut self) -> [i32; 4] {
        let (start_ns, system_ns) = (
            self.chain.slaves[0].start_ns,
            self.chain.slaves[0].system_ns(self.chain.true_ns),
        );
        let begun_ns = self.chain.true_ns;
        self.chain.slaves[0].start_ns = start_ns + (77 << 20);
        self.clocks.was_off(0);
        let restored =
            self.run(async |mut port, clocks| restore(&mut port, &STATIONS, clocks, 0, |_| Presence::Used).await);
        restored.expect("the clock");
        let Chain { slaves, true_ns, .. } = &self.chain;
        let first_ns = slaves[0].system_ns(*true_ns);
        let mut times_ns: [u64; 4] = core::array::from_fn(|slave| slaves[slave].system_ns(*true_ns));
        times_ns[0] = system_ns + (true_ns - begun_ns);
        times_ns.map(|time_ns| (first_ns as u32).wrapping_sub(time_ns as u32) as i32)
    }

    fn set_ahead(&mut self, slave: usize, ns: u64) {
        self.chain.slaves[slave].start_ns = self.chain.slaves[slave].start_ns.wrapping_add(ns);
    }
}

#[test]
fn the_first_clock_that_was_alone_and_still_has_the_time_gives_it_to_all() {
    const FAR_NS: u64 = 50_000_000;
    for (far, source) in [
        (&[][..], Some(1)),
        (&[1], Some(2)),
        (&[2, 3], Some(1)),
        (&[1, 2], Some(3)),
        (&[1, 2, 3], None),
    ] {
        for after_ms in [0, 900, 5_000] {
            let mut bus = Alone::new(&[1, 2, 3]);
            for slave in far {
                bus.set_ahead(*slave, [FAR_NS, FAR_NS.wrapping_neg()][slave % 2]);
            }
            bus.chain.log.clear();
            assert_eq!(bus.find(after_ms, &[0]), source, "far {far:?}, after {after_ms} ms");
            let restarts = bus.chain.log.matches("Fpwr:0930").count();
            assert_eq!(restarts, source.unwrap_or(3), "no clock that was looked at races on");
            bus.chain.log.clear();
            if source.is_none() {
                bus.find(0, &[0]);
                assert_eq!(bus.chain.log, "", "each is looked at once");
            }
            let off_ns = bus.restore_first();
            match source {
                Some(source) => assert_eq!(off_ns[source], 0, "far {far:?}: {off_ns:?}"),
                // The master's own time, by the milliseconds that it took to read the measurement.
                None => assert!(off_ns[0].abs() < 20_000_000, "{off_ns:?}"),
            }
        }
    }
}

#[test]
fn how_far_a_clock_may_be_grows_with_the_time_since_the_last_reading_until_32_bits_say_nothing() {
    for (wait_ms, near_ms, far_ms) in [
        (0, 15, 25),
        (1_000, 15, 25),
        (1_000_000, 215, 225),
        (3_600_000, 735, 745),
    ] {
        for sign in [1_i64, -1] {
            for (off_ms, is_near) in [(near_ms, true), (far_ms, false)] {
                let mut bus = Alone::new(&[3]);
                bus.set_ahead(3, (sign * off_ms * 1_000_000) as u64);
                let source = bus.find(wait_ms, &[0, 1, 2]);
                assert_eq!(source.is_some(), is_near, "{off_ms} ms off after {wait_ms} ms");
            }
        }
    }
    for (off_ms, is_near) in [(995, true), (1_005, false)] {
        let mut bus = Alone::new(&[3]);
        // Four hours: 2.9 s at 200 parts per million, of 4.3 s that 32 bits hold.
        bus.clocks.read_ms = bus.clocks.read_ms.wrapping_sub(4 * 3_600_000);
        bus.set_ahead(3, off_ms * 1_000_000);
        bus.set_ahead(3, (4 * 3_600_000_000_000_u64) & u64::from(u32::MAX));
        assert_eq!(
            bus.find(0, &[0, 1, 2]).is_some(),
            is_near,
            "{off_ms} ms off after four hours"
        );
    }
}

#[test]
fn a_clock_that_could_not_be_read_is_looked_at_again() {
    let mut bus = Alone::new(&[1, 2]);
    // The frames with both clocks' registers are lost, and those that repeat them.
    bus.chain.miscounted = bus.chain.frames + 1..bus.chain.frames + 1_000;
    bus.chain.miscount = 1;
    assert_eq!(bus.find(0, &[0, 3]), None);
    bus.chain.miscounted = 0..0;
    assert_eq!(bus.find(0, &[0, 3]), Some(1));
}

#[test]
fn a_slave_that_is_lost_while_the_time_goes_on_does_not_bring_its_own_back() {
    for (seconds, source) in [(1, Some(2)), (3_600, None)] {
        let mut bus = Alone::new(&[]);
        // The third slave is away, and a crystal 100 ppm fast is alone for as long.
        bus.chain.slaves[2].drift_ppb = 100_000;
        bus.set_ahead(2, (bus.chain.true_ns / 10_000).wrapping_neg());
        for _ in 0..seconds {
            bus.follow(1_000, &[2]);
        }
        assert!(!bus.clocks.is_set(2));
        // It returns when all others have gone.
        assert_eq!(bus.find(0, &[0, 1, 3]), source, "after {seconds} s");
    }
}
