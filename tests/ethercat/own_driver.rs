//! A driver of the application's own: members with process data in one direction only.

use crate::bench;
use etherpen::ethercat::configure::{Direction, PreOperational};
use etherpen::ethercat::driver::{DeviceDescription, PdoChoice, ProcessData, Setting, SlaveFactory, Windows};
use etherpen::ethercat::error::BusError;
use etherpen::ethercat::event::BusSetup;
use etherpen::ethercat::wire::sii::Identity;
use etherpen_segment::{AlState, SegmentOptions, SlaveKind};

/// Process data objects that every slave here has.
const NO_PDO: PdoChoice = PdoChoice {
    pdo: 0,
    entries: &[],
    written: false,
};

/// Any slave whose device type is that of a servo drive, with its data in one direction only.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct OneWay<const INPUTS: bool>;

impl<const INPUTS: bool> SlaveFactory for OneWay<INPUTS> {
    type Device = ();
    type Layout = ();
    type Settings = ();

    fn by_identity(_: &Identity) -> Option<()> {
        None
    }

    fn by_device_type(device_type: u32) -> Option<()> {
        (device_type & 0xFFFF == 402).then_some(())
    }

    fn describe((): ()) -> DeviceDescription {
        DeviceDescription {
            name: "one way",
            ..DeviceDescription::default()
        }
    }

    async fn configure<const MESSAGE: usize>(
        (): &(),
        (): (),
        _: Option<u8>,
        slave: &mut PreOperational<'_, '_, MESSAGE>,
        _: Option<&ProcessData<Self>>,
    ) -> Result<Option<ProcessData<Self>>, BusError> {
        let unassigned = if INPUTS { 0x1C12 } else { 0x1C13 };
        slave.write(&Setting::new(unassigned, 0, 0, 1)).await?;
        let mut bits = [0_u16; 2];
        for (direction, bits) in [Direction::Outputs, Direction::Inputs].into_iter().zip(&mut bits) {
            let count = |entry: etherpen::ethercat::configure::Entry| {
                *bits += u16::from(entry.bits);
                Ok(())
            };
            slave.entries(direction, &NO_PDO, count).await?;
        }
        let windows = slave.windows(Windows::standard(0x1100, 0x1180)).await?;
        let [outputs, inputs] = bits;
        Ok(Some(ProcessData {
            windows,
            output_length: outputs / 8,
            input_length: inputs / 8,
            layout: (),
        }))
    }
}

/// Brings two such members up, and returns the lengths of their data.
fn lengths<const INPUTS: bool>() -> Vec<(u16, u16)> {
    let options = SegmentOptions {
        slaves: vec![SlaveKind::Cia402, SlaveKind::El1008, SlaveKind::Cia402],
        ..SegmentOptions::default()
    };
    let setup = BusSetup {
        members: 2,
        watchdog_ms: 100,
        ..BusSetup::default()
    };
    let mut bench = bench::Bench::<8, 0, OneWay<INPUTS>>::start(&options, setup);
    bench.operational();
    let states = bench.segment.slaves();
    let states: Vec<AlState> = states.iter().map(|slave| slave.al_state).collect();
    assert_eq!(
        states,
        [AlState::Operational, AlState::Init, AlState::Operational],
        "{:#?}",
        bench.log
    );
    bench.run_ms(200);
    let counters = bench.exchange.counters();
    assert_eq!((counters.frames_lost, counters.working_counter_errors), (0, 0));
    let shares = bench.exchange.plan().slaves.iter();
    shares.map(|share| (share.output_length, share.input_length)).collect()
}

#[test]
pub(crate) fn members_with_inputs_or_outputs_only_operate_on_slaves_that_refuse_an_empty_sync_manager() {
    let inputs = lengths::<true>();
    assert!(
        inputs[0].0 == 0 && inputs[0].1 > 0 && inputs[2] == inputs[0],
        "{inputs:?}"
    );
    let outputs = lengths::<false>();
    assert!(
        outputs[0].0 > 0 && outputs[0].1 == 0 && outputs[2] == outputs[0],
        "{outputs:?}"
    );
}
