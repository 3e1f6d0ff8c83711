//! What the operator decides from the reports that the line has carried.

use super::super::chance::Chance;
use super::super::episode::{Figure, Wish};
use super::super::ink;
use super::{Operator, Stage, test_figure};
use etherpen::application::{Fault as Reason, Mode};
use etherpen::ethercat::diagnostics::ServiceRequest;
use etherpen::ethercat::error::IdentityProperty;
use etherpen::ethercat::state::AlState;
use etherpen::link::message::PathAck;
use etherpen::messages::Command;
use etherpen::motion::Pen;
use etherpen::robots::{JointAngles, Position};
use std::f64::consts::TAU;
use std::sync::Arc;

/// Distance of all joints from their marks within which the operator homes at the marks, turns of the motor: from half a
/// turn on, the mark of the next turn is nearer.
const AT_MARKS_TURNS: f64 = 0.3;
/// Longest wait for an answer, ms.
const ANSWER_MAX_MS: u32 = 1_500;
/// Silence after which the operator connects again, ms.
const SILENCE_MAX_MS: u64 = 3_000;
/// Time between two messages of a jog, ms.
const JOG_REPEAT_MS: u32 = 20;
/// Time without progress after which the operator gives a drawing up, ms.
const PATIENCE_MAX_MS: u32 = 8_000;
/// Acknowledgements without effect after which the configuration is sent again: a board that was restarted has none.
const ACKNOWLEDGED_MAX: u32 = 3;
/// Resets of the board once everything is healed.
const RESETS_MAX: u32 = 1;
/// Drives that can be put in the place of another one: product code, and the name in the script of faults.
const PRODUCTS: [(u32, &str); 2] = [(0x07D0_6014, "ax2000"), (0x0402, "cia402")];
/// Speed of a joint below which it counts as resting, rad/s.
const RESTING_RAD_S: f64 = 0.05;
/// How far from the middle of the sheet detours lead, sides of the sheet.
const DETOUR_SHEETS: f64 = 2.0;
/// Pause between two decisions once everything is healed, ms.
const HEALED_PATIENCE_MS: u32 = 100;

impl Operator<'_> {
    pub(super) fn say(&mut self, command: Command) {
        self.awaited = Some((self.session.command(command), self.now_ms));
        self.session.inquire();
    }

    /// Decides what to do from what was reported last.
    pub(super) fn decide(&mut self) {
        let is_free = self.stage == Stage::Free;
        let patience_ms = if is_free {
            self.episode.patience_ms
        } else {
            HEALED_PATIENCE_MS
        };
        self.decide_ms = self.now_ms + patience_ms.max(1);
        if self
            .session
            .silence_ms(self.now_ms.into())
            .is_some_and(|ms| ms > SILENCE_MAX_MS)
        {
            return self.reconnect();
        }
        self.session.inquire();
        if self
            .awaited
            .is_some_and(|(_, since_ms)| self.now_ms < since_ms + ANSWER_MAX_MS)
            || self.jog.is_some()
        {
            return;
        }
        let Some(status) = &self.status else { return };
        let (mode, homed, recovering) = (status.mode, status.referenced, status.recovering);
        let is_configured = status.config == self.config.hash();
        let homes = !homed || self.judge.asks_for_homing();
        if mode == Mode::Idle {
            self.acknowledged = 0;
        }
        match mode {
            _ if recovering => {}
            Mode::Fault if self.acknowledged >= ACKNOWLEDGED_MAX && self.needs_reset() => self.presses_reset = true,
            Mode::Fault if self.acknowledged >= ACKNOWLEDGED_MAX => {
                self.acknowledged = 0;
                self.configure();
            }
            Mode::Fault => {
                self.acknowledged += 1;
                self.put_right();
                self.say(Command::Acknowledge);
            }
            Mode::Startup | Mode::BusConfiguring | Mode::DrivesOff if !is_configured => self.configure(),
            Mode::Startup | Mode::BusConfiguring | Mode::Stopping | Mode::Homing | Mode::Moving => {}
            Mode::DrivesOff if homes && self.raise_parked() => {}
            // As the refusal says: the operator has taken the terminal out of OP.
            Mode::DrivesOff if std::mem::take(&mut self.misses_terminal) => self.say(Command::Acknowledge),
            // The axes go to their switches with power.
            Mode::DrivesOff if self.has_switches => self.say(Command::Enable),
            Mode::Unreferenced | Mode::Idle if self.has_switches && homes => {
                self.say(Command::Home);
            }
            Mode::DrivesOff | Mode::Unreferenced if homes => self.home(),
            Mode::DrivesOff => self.say(Command::Enable),
            Mode::Unreferenced => self.say(Command::Disable),
            Mode::Idle if self.judge.asks_for_homing() => self.say(Command::Disable),
            Mode::Idle if is_free => self.wish(),
            Mode::Idle if std::mem::take(&mut self.detours.1) => self.go_round(),
            Mode::Idle => self.draw_test(),
            Mode::Drawing | Mode::Holding if self.ack.job != self.job || self.is_stuck() => self.say(Command::Cancel),
            Mode::Holding => self.say(Command::Resume),
            Mode::Drawing => {}
        }
    }

    /// Brings a slave back to OP that the operator has taken out of it: without its position the robot cannot be homed.
    /// Returns whether there is one.
    fn raise_parked(&mut self) -> bool {
        let slaves = self.status.iter().flat_map(|status| &status.slaves);
        let is_below = |al_state: u8| (AlState::Init as u8..AlState::Operational as u8).contains(&al_state);
        let used = slaves.enumerate().filter(|(place, _)| self.chain.is_used(place + 1));
        let parked = used.into_iter().find(|(_, slave)| is_below(slave.al_state));
        let Some((slave, _)) = parked.filter(|_| self.stage != Stage::Free) else {
            return false;
        };
        self.session.bus(ServiceRequest::SetState {
            slave: slave as u8,
            state: AlState::Operational,
        });
        true
    }

    /// Puts the product back that the controller asks for: the drives may have been exchanged before it first saw them. Where
    /// it asks for a drive in the place of a terminal, it first saw the chain without a slave, and is given the configuration
    /// again.
    pub(super) fn put_right(&mut self) {
        let fault = self.status.as_ref().and_then(|status| status.fault);
        let Some(Reason::OtherProduct { slave, expected, .. }) = fault else {
            return;
        };
        let product = PRODUCTS.iter().find(|(code, _)| *code == expected);
        if let Some((_, name)) = product.filter(|_| self.stage != Stage::Free) {
            if self.chain.axis(usize::from(slave) + 1).is_none() {
                return self.configure();
            }
            self.inject(&format!("swap {} {name}", slave + 1));
            self.judge.healed();
        }
    }

    /// Whether everything is healed and at its place, and only a reset helps, as the fault says: the board first saw the slaves
    /// exchanged, or read a damaged memory.
    fn needs_reset(&self) -> bool {
        let fault = self.status.as_ref().and_then(|status| status.fault);
        let is_of_first_sight = match fault {
            Some(Reason::OtherProduct { expected, found, .. }) => expected == found,
            Some(Reason::WrongSlave { property, other, .. }) => {
                property == IdentityProperty::Station && other.is_some()
            }
            _ => false,
        };
        is_of_first_sight && self.misled_at_first && self.stage != Stage::Free && self.resets < RESETS_MAX
    }

    /// Whether the drawing has not advanced for long.
    pub(super) fn is_stuck(&mut self) -> bool {
        if self.advanced.0 != self.ack.executed {
            self.advanced = (self.ack.executed, self.now_ms);
        }
        self.stage == Stage::Free && self.now_ms > self.advanced.1 + PATIENCE_MAX_MS
    }

    pub(super) fn configure(&mut self) {
        if self
            .configured_ms
            .is_none_or(|since_ms| self.now_ms > since_ms + ANSWER_MAX_MS)
        {
            self.session.configure(self.config.clone());
            self.configured_ms = Some(self.now_ms);
        }
    }

    /// Homes: at the marks if the joints are there, or anywhere if the encoders know the pose, else at the pose that the operator
    /// measures.
    pub(super) fn home(&mut self) {
        let angles_rad = self.world.truth().angles_rad;
        let marks = self
            .config
            .axes
            .iter()
            .take(self.chain.drives.len())
            .map(|axis| (axis.sync_angle_rad, AT_MARKS_TURNS * TAU / axis.gear.abs()));
        let at_marks = angles_rad
            .iter()
            .zip(marks)
            .all(|(angle, (mark, near_rad))| (angle - mark).abs() < near_rad);
        let mut axes = self.config.axes.iter().take(self.chain.drives.len());
        let knows_pose = axes.all(etherpen::config::Axis::knows_turns);
        self.say(match at_marks || knows_pose {
            true => Command::Home,
            false => Command::HomeAt {
                pose: JointAngles(angles_rad),
                position: None,
            },
        });
    }

    /// Carries out the next wish.
    pub(super) fn wish(&mut self) {
        let episode = self.episode;
        let Some(wish) = episode.wishes.get(self.next_wish % episode.wishes.len().max(1)) else {
            return;
        };
        self.next_wish += 1;
        match wish {
            Wish::Draw(index) => {
                if let Some(figure) = episode.figures.get(*index) {
                    self.draw(figure);
                }
            }
            Wish::Move([x_mm, y_mm, z_mm]) => self.say(Command::Move {
                position: Position {
                    x_mm: *x_mm,
                    y_mm: *y_mm,
                    z_mm: *z_mm,
                },
            }),
            Wish::Jog(velocity_mm_s, duration_ms) => {
                self.jog = Some((*velocity_mm_s, self.now_ms.saturating_add(*duration_ms)));
            }
            Wish::Pen => {
                let pen = if self.next_wish.is_multiple_of(2) {
                    Pen::Up
                } else {
                    Pen::Down
                };
                self.say(Command::Pen { pen });
            }
            Wish::Disable => self.say(Command::Disable),
            Wish::Override(percent) => self.say(Command::Override { percent: *percent }),
            Wish::AtOnce(commands) => {
                let pose = JointAngles(self.world.truth().angles_rad);
                for command in commands {
                    self.put_beside(match command {
                        Command::Home if !self.has_switches => Command::HomeAt { pose, position: None },
                        other => *other,
                    });
                }
            }
        }
    }

    pub(super) fn draw(&mut self, figure: &Figure) {
        self.job = self.job.wrapping_add(1);
        self.drawing = figure.path(&self.config).into();
        self.ack = PathAck::default();
        self.advanced = (0, self.now_ms);
        self.judge.orders(self.job, &self.drawing);
        self.say(Command::Draw { job: self.job });
        self.session.start_path(self.job, Arc::clone(&self.drawing));
    }

    /// Draws the test figure, again if it was not drawn to its end, at full speed.
    pub(super) fn draw_test(&mut self) {
        let since_ms = match self.stage {
            Stage::Healed { since_ms } | Stage::Testing { since_ms, .. } => since_ms,
            _ => return,
        };
        if self
            .status
            .as_ref()
            .is_some_and(|status| status.override_percent != 100)
        {
            return self.say(Command::Override { percent: 100 });
        }
        // The motors follow the end of a motion, and a low pen may touch meanwhile: that ink is not the drawing's.
        if self
            .world
            .truth()
            .speeds_rad_s
            .iter()
            .any(|speed| speed.abs() > RESTING_RAD_S)
        {
            return;
        }
        let inked = self.world.look(|cell, _| ink::points(cell.ink()));
        self.stage = Stage::Testing { since_ms, inked };
        self.draw(&test_figure(&self.config.paper));
    }

    /// Moves to another place, because the straight way to the drawing leads through a part that the robot cannot reach: to
    /// the corners of the sheet first, then to places by chance.
    fn go_round(&mut self) {
        let (paper, tried) = (&self.config.paper, self.detours.0);
        self.detours.0 += 1;
        let mut chance = Chance::new(self.episode.seed ^ tried);
        let side = |right: bool| if right { 0.5 } else { -0.5 };
        let part = match tried {
            0..4 => [side(tried & 1 != 0), side(tried & 2 != 0)],
            _ => [(); 2].map(|()| chance.between(-DETOUR_SHEETS, DETOUR_SHEETS)),
        };
        let [x_mm, y_mm] = [0, 1].map(|axis| paper.centre_mm[axis] + part[axis] * paper.size_mm[axis]);
        let z_mm = paper.pen_down_z_mm + paper.pen_lift_mm;
        self.say(Command::Move {
            position: Position { x_mm, y_mm, z_mm },
        });
    }

    pub(super) fn repeat_jog(&mut self) {
        let Some((velocity_mm_s, until_ms)) = self.jog else {
            return;
        };
        if self.now_ms >= until_ms || !matches!(self.mode(), Mode::Idle | Mode::Moving) {
            self.jog = None;
        } else if self.now_ms.is_multiple_of(JOG_REPEAT_MS) {
            self.session.command(Command::Jog { velocity_mm_s });
        }
    }
}
