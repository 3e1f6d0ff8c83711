//! A protocol for the tests: a machine that draws on one line.

use crate::message::HostMessage;
use crate::{CommandEffect, Protocol};
use heapless::Vec;
use proptest::prelude::*;
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};
use serde::{Deserialize, Serialize};

/// The machine of the tests.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Example;

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) enum Command {
    Enable,
    Draw { job: u16 },
    Cancel,
    Stop,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) enum Refusal {
    NotReady,
}

/// State of the machine: the number of its state, and padding that makes the message as long as a real one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Status {
    pub(crate) state: u8,
    pub(crate) details: Vec<u32, 32>,
}

impl Status {
    pub(crate) fn long(state: u8) -> Self {
        Self {
            state,
            details: core::iter::repeat_n(u32::MAX, 32).collect(),
        }
    }
}

impl Protocol for Example {
    const VERSION: u16 = 3;
    type Config = Vec<u8, 600>;
    type ConfigRefusal = Refusal;
    type Command = Command;
    type Refusal = Refusal;
    type Vertex = i32;
    type VertexRefusal = u32;
    type Status = Status;
    type Sample = [f32; 4];
    type PreviousRun = u8;
    type BusRequest = u16;
    type BusResult = Result<u32, Refusal>;
    type MeasurementRequest = ();
    type MeasurementAnswer = u64;
    const NO_PREVIOUS_RUN: u8 = 0;

    fn effect(command: &Command) -> CommandEffect {
        match *command {
            Command::Enable => CommandEffect::None,
            Command::Draw { job } => CommandEffect::OpensPath { job },
            Command::Cancel => CommandEffect::ClosesPath,
            Command::Stop => CommandEffect::Stops,
        }
    }
}

/// A configuration as long as it can be, with bytes of every value.
pub(crate) fn configuration() -> Vec<u8, 600> {
    (0..600).map(|place| (place * 7) as u8).collect()
}

/// A part of a path: each vertex is its own index.
pub(crate) fn part(first: u32, count: usize) -> Vec<i32, 16> {
    (first as i32..).take(count).collect()
}

pub(crate) fn command(id: u16, command: Command) -> HostMessage<Example> {
    HostMessage::Command { id, command }
}

/// Checks a property for values of a strategy, the same values in every run.
pub(crate) fn check<S: Strategy>(cases: u32, strategy: S, property: impl Fn(S::Value) -> Result<(), TestCaseError>) {
    const SEED: [u8; 32] = *b"etherpen: properties of the link";
    let config = Config {
        cases,
        failure_persistence: None,
        ..Config::default()
    };
    let rng = TestRng::from_seed(RngAlgorithm::ChaCha, &SEED);
    if let Err(failure) = TestRunner::new_with_rng(config, rng).run(&strategy, property) {
        panic!("seed {:?}: {failure}", core::str::from_utf8(&SEED));
    }
}
