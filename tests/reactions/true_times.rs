//! True system times of the slaves' clocks, each millisecond: no frame and no register is between them and the tests.

/// Follows how the clocks of all slaves go from millisecond to millisecond.
#[derive(Default)]
pub(crate) struct Steps {
    /// True time and system times of the last look, ns.
    before: Option<(u64, Vec<u64>)>,
    /// What each clock has gained in each step on the true time that passed, ns.
    gained_ns: Vec<Vec<i64>>,
}

impl Steps {
    /// Sees the system times at a true time, a millisecond after the last ones.
    pub(crate) fn see(&mut self, true_ns: u64, times_ns: &[Option<u64>]) {
        let now_ns: Vec<u64> = times_ns.iter().map(|time_ns| time_ns.expect("a clock")).collect();
        if let Some((before_true_ns, before_ns)) = self.before.replace((true_ns, now_ns.clone())) {
            let passed_ns = true_ns - before_true_ns;
            let gained_ns = |(now_ns, before_ns): (&u64, &u64)| {
                now_ns.wrapping_sub(*before_ns).wrapping_sub(passed_ns).cast_signed()
            };
            self.gained_ns
                .push(now_ns.iter().zip(&before_ns).map(gained_ns).collect());
        }
    }

    /// Number of steps.
    pub(crate) fn seen(&self) -> u32 {
        self.gained_ns.len() as u32
    }

    /// Largest step of a slave, from 1, and all its steps together, ns.
    pub(crate) fn of(&self, slave: usize) -> [i64; 2] {
        let steps = self.gained_ns.iter().map(|step| step[slave - 1]);
        [steps.clone().map(i64::abs).max().unwrap_or(0), steps.sum()]
    }
}
