//! Building the frames of a plan.
//!
//! Invariant: outputs survive a new plan only where the slave's share and role are unchanged; all others begin with 0.

use super::further::Turn;
use super::{CyclicPlan, CyclicSlave, Exchange, InputPlace, OutputPlace, PROCESS_BYTES_MAX};
use crate::driver::SlaveFactory;
use crate::plan::{STATUS_BYTES, Window};
use crate::queue;
use crate::wire::write_bytes;

impl<F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize, const FURTHER: usize>
    Exchange<'_, F, SLAVES, MESSAGE, FURTHER>
{
    #[cold]
    pub(super) fn take_plan(&mut self) {
        if let Some(plan) = queue::take(&mut self.end.plans) {
            self.adopt(plan);
        }
    }

    /// Builds the telegrams of a plan; outputs are kept for slaves whose share and role are unchanged.
    pub(super) fn adopt(&mut self, plan: CyclicPlan<F, SLAVES>) {
        let mut kept = [[0; PROCESS_BYTES_MAX]; SLAVES];
        for (number, (new, kept)) in plan.slaves.iter().zip(&mut kept).enumerate() {
            let old = self.plan.slaves.get(number).copied().unwrap_or_default();
            let same = (old.output_address, old.output_length) == (new.output_address, new.output_length);
            // Outputs that are no longer written return to zero. Nobody writes those of a terminal that is out of operation,
            // and it would show them as soon as it is back.
            let used = (old.role, self.plan.terminals.contains(number) && old.watched);
            if same && used == (new.role, plan.terminals.contains(number) && new.watched) {
                write_bytes(kept, 0, self.output(number));
            }
        }
        let carried_ns = self.carried_for(&plan);
        self.first.clear(&self.encapsulation, self.source);
        self.second.clear(&self.encapsulation, self.source);
        self.further.clear(&self.encapsulation, self.source);
        self.outputs = [OutputPlace::default(); SLAVES];
        self.inputs = [InputPlace::default(); SLAVES];
        let unconfirmed = self.unconfirmed();
        (self.second_only, self.output_members) = (0, 0);
        let (mut firsts, mut seconds) = plan.dealers(1 + FURTHER);
        let mut image = 0;
        for (number, slave) in (0..).zip(&plan.slaves) {
            let (first, second) = (slave.first_window(plan.exchange), slave.second_window(plan.exchange));
            if let Some(window) = &first {
                let frame = firsts.frame(number, window);
                // The inputs of a frame lie together: a slave that has no room takes no image.
                image += u8::from(self.push_first(number, slave, window, (frame, image)));
            }
            if let Some(window) = &second {
                let frame = seconds.frame(number, window);
                let takes_part = slave.role.is_some() || plan.terminals.contains(number.into());
                let kind = (slave.watched && takes_part, first.is_none());
                self.push_second(number, slave, window, frame, kind);
            }
        }
        self.unconfirmed = unconfirmed.first() & self.output_members;
        self.further.set_unconfirmed(unconfirmed);
        self.first.push_common(plan.clock);
        if let Some(time_ns) = carried_ns {
            self.first.carry(time_ns);
        }
        self.first.finish(&self.encapsulation);
        self.second.finish(&self.encapsulation);
        self.further.finish(&self.encapsulation);
        self.plan = plan;
        self.plan_number = self.plan_number.wrapping_add(1);
        for (number, kept) in kept.iter().enumerate() {
            let output = self.output(number);
            let length = output.len();
            write_bytes(output, 0, kept.get(..length).unwrap_or(&[]));
        }
    }

    /// The time that the clock's datagram carries, for a plan with the same time: it is written to the slaves in front of the
    /// reference, and to all others while the reference does not answer. The upper half of a clock of 32 bits is not known.
    fn carried_for(&self, plan: &CyclicPlan<F, SLAVES>) -> Option<u64> {
        let (old, new) = (self.plan.clock?, plan.clock?);
        let is_known = old.time_number == new.time_number && (old.wide || !new.wide);
        self.first.carried_ns().filter(|_| is_known)
    }

    /// Adds a slave's datagram to a telegram of the cycle's start: the number of the frame, and of the slave's inputs.
    /// Returns whether there was room.
    fn push_first(&mut self, slave: u8, share: &CyclicSlave<F>, window: &Window, (frame, image): (usize, u8)) -> bool {
        let data = match frame.checked_sub(1) {
            None => self
                .first
                .push_share(slave, share.watched, window, STATUS_BYTES)
                .map(|(_, data)| data),
            Some(number) => {
                let watched = (slave, share.watched);
                self.further.push((number, Turn::First), watched, window, image)
            }
        };
        let Some(data) = data else { return false };
        if let Some(inputs) = self
            .inputs
            .get_mut(usize::from(slave))
            .filter(|_| window.input_length > 0)
        {
            let further = (frame > 0).then_some(slave);
            let bit = if frame == 0 { 1 << (slave & 31) } else { 0 };
            *inputs = InputPlace { image, further, bit };
        }
        self.place_outputs(slave, window, (frame, data));
        true
    }

    /// Adds a slave's datagram to a telegram after control: the number of the frame, whether the slave is a watched member
    /// or terminal, and whether this is its only datagram.
    fn push_second(
        &mut self,
        slave: u8,
        share: &CyclicSlave<F>,
        window: &Window,
        frame: usize,
        (is_member, is_only): (bool, bool),
    ) {
        let bit = |is_set| if is_set { 1 << (slave & 31) } else { 0 };
        let data = match frame.checked_sub(1) {
            None => {
                self.second_only |= bit(is_only);
                self.output_members |= bit(is_member);
                self.second
                    .push_share(slave, share.watched, window, 0)
                    .map(|(_, data)| data)
            }
            Some(number) => {
                self.further.note(number, slave, (is_member, is_only));
                let watched = (slave, share.watched);
                self.further.push((number, Turn::Second), watched, window, 0)
            }
        };
        if let Some(data) = data {
            self.place_outputs(slave, window, (frame, data));
        }
    }

    /// Notes where a slave's outputs are: the number of the frame, and the place of its data in the frame.
    fn place_outputs(&mut self, slave: u8, window: &Window, (frame, data): (usize, usize)) {
        if let Some(outputs) = self
            .outputs
            .get_mut(usize::from(slave))
            .filter(|_| window.output_length > 0)
        {
            let start = data + usize::from(window.output_offset);
            *outputs = OutputPlace::new(frame, start, window.output_length);
        }
    }
}
