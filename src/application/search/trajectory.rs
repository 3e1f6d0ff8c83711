//! A model of the trajectory task, small enough to be searched, and its comparison with the real task.
//!
//! A [`Model`] takes the task's orders at once and ends a motion only on request, so a motion may take any time. The
//! real task makes no step between two releases, so taking orders at once is exact. Invariant: the model allows
//! everything that the real task reports.

extern crate std;

use crate::application::Progress;
use crate::motion::MotionCommand;
use crate::trajectory_task::MotionOrder;
use std::vec::Vec;

/// Motion of the trajectory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(super) enum Doing {
    #[default]
    Rest,
    /// A jog, a move, or a deceleration to rest after which nothing follows.
    Moving,
    /// On the path; nothing follows it.
    Path,
    /// Decelerating to a hold.
    Braking,
    Held,
}

/// State of the announced path's data.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(super) enum Data {
    #[default]
    None,
    /// Announced.
    Awaited,
    /// Announced, and held before it began.
    Held,
    /// All of it has arrived.
    Come,
}

/// The trajectory task.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Model {
    /// Number of the start to which its setpoints belong.
    pub(super) epoch: Option<u8>,
    /// Whether it has a pose.
    pub(super) placed: bool,
    pub(super) doing: Doing,
    pub(super) data: Data,
}

impl Model {
    /// Takes an order. `otherwise` selects the second outcome where the real task has two: a target may be outside the
    /// work area, and a deceleration may have ended already.
    pub(super) fn take(&mut self, order: &MotionOrder, otherwise: bool) {
        match order {
            MotionOrder::Configure(_) => *self = Self::default(),
            MotionOrder::Place { epoch, .. } => {
                (self.epoch, self.placed, self.doing) = (Some(*epoch), true, Doing::Rest);
            }
            MotionOrder::BeginPath if self.data == Data::Held => {}
            MotionOrder::BeginPath => self.data = Data::Awaited,
            MotionOrder::Abandon => (self.epoch, self.data) = (None, Data::None),
            MotionOrder::Command(command) => self.command(*command, otherwise),
        }
    }

    fn command(&mut self, command: MotionCommand, otherwise: bool) {
        match command {
            MotionCommand::Cancel => self.data = Data::None,
            MotionCommand::Hold if self.data == Data::Awaited => self.data = Data::Held,
            MotionCommand::Resume if self.data == Data::Held => self.data = Data::Awaited,
            _ => {}
        }
        if !self.placed {
            return;
        }
        self.doing = match (command, self.doing) {
            (MotionCommand::Cancel, Doing::Braking) if otherwise => Doing::Rest,
            (MotionCommand::Cancel, Doing::Path | Doing::Braking) => Doing::Moving,
            (MotionCommand::Cancel, Doing::Held) => Doing::Rest,
            (MotionCommand::Hold, Doing::Path) => Doing::Braking,
            (MotionCommand::Resume, Doing::Braking | Doing::Held) => Doing::Path,
            (MotionCommand::MoveTo(_) | MotionCommand::Pen(_) | MotionCommand::Jog(_), Doing::Rest) if !otherwise => {
                Doing::Moving
            }
            (_, doing) => doing,
        };
    }

    /// Brings the complete path.
    pub(super) fn bring_path(&mut self) {
        if self.data == Data::Awaited {
            let begins = self.placed && self.doing == Doing::Rest;
            (self.data, self.doing) = match begins {
                true => (Data::Come, Doing::Path),
                false => (Data::None, self.doing),
            };
        }
    }

    /// Ends the present motion; call it only while the sampler takes the setpoints.
    pub(super) fn arrive(&mut self) {
        self.doing = match self.doing {
            Doing::Rest | Doing::Moving => Doing::Rest,
            Doing::Path => {
                self.data = Data::None;
                Doing::Rest
            }
            Doing::Braking | Doing::Held => Doing::Held,
        };
    }

    pub(super) fn progress(&self) -> Progress {
        Progress {
            idle: self.doing == Doing::Rest && self.data == Data::None,
            held: self.doing == Doing::Held || self.data == Data::Held,
            ..Progress::default()
        }
    }
}

/// All states of the model that agree with the reports so far.
struct Guesses(Vec<Model>);

impl Guesses {
    fn each(&mut self, change: impl Fn(Model) -> Vec<Model>) {
        let mut next: Vec<Model> = Vec::new();
        for guess in self.0.drain(..).flat_map(change) {
            if !next.contains(&guess) {
                next.push(guess);
            }
        }
        self.0 = next;
    }
}

mod real {
    //! The real task, driven by random orders.

    use super::*;
    use crate::config::Config;
    use crate::control::sampler::Queued;
    use crate::motion::{PERIOD_MS, Pen, Trajectory, Vertex};
    use crate::robots::{JointAngles, Kinematics, Position};
    use crate::trajectory_task::{MotionReport, PathItem, TrajectoryTask};
    use heapless::spsc::{Consumer, Producer, Queue};
    use host_tools::random::XorshiftStar;
    use std::boxed::Box;
    use std::{println, vec};

    struct Bench {
        task: TrajectoryTask<'static>,
        orders: Producer<'static, MotionOrder>,
        vertices: Producer<'static, PathItem>,
        setpoints: Consumer<'static, Queued>,
        reports: Consumer<'static, MotionReport>,
    }

    fn queue<T, const N: usize>() -> (Producer<'static, T>, Consumer<'static, T>) {
        Box::leak(Box::new(Queue::<T, N>::new())).split()
    }

    impl Bench {
        fn new() -> Self {
            let (orders, orders_out) = queue::<_, 17>();
            let (vertices, vertices_out) = queue::<_, 65>();
            let (setpoints_in, setpoints) = queue::<_, 40>();
            let (reports_in, reports) = queue::<_, 5>();
            let trajectory = Box::leak(Box::new(Trajectory::unconfigured()));
            let task = TrajectoryTask::new(trajectory, orders_out, vertices_out, setpoints_in, reports_in);
            Self {
                task,
                orders,
                vertices,
                setpoints,
                reports,
            }
        }

        /// Releases the task; the sampler takes the setpoints of this start and of no other.
        fn release(&mut self, followed: Option<u8>) -> MotionReport {
            self.task.release();
            for _ in 0..PERIOD_MS {
                while self
                    .setpoints
                    .peek()
                    .is_some_and(|queued| Some(queued.epoch) != followed)
                    && followed.is_some()
                {
                    self.setpoints.dequeue();
                }
                if followed.is_some() {
                    self.setpoints.dequeue();
                }
            }
            self.reports.dequeue().expect("a report")
        }
    }

    const ABOVE: Position = Position {
        x_mm: 0.0,
        y_mm: 0.0,
        z_mm: -840.0,
    };

    fn pose(config: &Config) -> JointAngles {
        let kinematics = Kinematics::new(&config.geometry).expect("a robot");
        let [first, second, third] = kinematics.inverse(&ABOVE).expect("it is reached");
        JointAngles([first, second, third, 0.0])
    }

    fn somewhere(random: &mut XorshiftStar, z_mm: f64) -> Position {
        Position {
            x_mm: random.below(60) as f64 - 30.0,
            y_mm: random.below(60) as f64 - 30.0,
            z_mm,
        }
    }

    fn order(random: &mut XorshiftStar, pose: JointAngles, epoch: &mut u8) -> MotionOrder {
        MotionOrder::Command(match random.below(9) {
            0 => {
                *epoch = epoch.wrapping_add(1);
                return MotionOrder::Place { pose, epoch: *epoch };
            }
            1 => return MotionOrder::Abandon,
            2 => return MotionOrder::BeginPath,
            3 => MotionCommand::Hold,
            4 => MotionCommand::Resume,
            5 => MotionCommand::Cancel,
            6 => MotionCommand::MoveTo(somewhere(random, -840.0)),
            7 => MotionCommand::Pen(Pen::Up),
            _ => MotionCommand::Jog([20.0, 5.0, 0.0]),
        })
    }

    /// Whether the operating modes may give this order: they never start another path or motion while one runs.
    fn is_given(order: &MotionOrder, guesses: &Guesses) -> bool {
        let all = |holds: fn(&Model) -> bool| guesses.0.iter().all(holds);
        let at_rest = all(|guess| guess.doing == Doing::Rest && guess.data == Data::None);
        match order {
            MotionOrder::BeginPath => at_rest,
            MotionOrder::Command(MotionCommand::MoveTo(_) | MotionCommand::Pen(_)) => at_rest,
            MotionOrder::Command(MotionCommand::Jog(_)) => all(|guess| guess.data == Data::None),
            MotionOrder::Place { .. } => all(|guess| guess.data == Data::None),
            _ => true,
        }
    }

    fn walk(seed: u64) -> (usize, usize) {
        let mut random = XorshiftStar::new(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1);
        let config = Config::default();
        let pose = pose(&config);
        let mut bench = Bench::new();
        let mut guesses = Guesses(vec![Model::default()]);
        assert!(
            bench
                .orders
                .enqueue(MotionOrder::Configure(config.motion_settings()))
                .is_ok()
        );
        let (mut epoch, mut followed, mut taken, mut arrivals) = (0, None, 0, 0);
        let mut story: Vec<std::string::String> = Vec::new();
        for _ in 0..600 {
            let before = taken;
            for _ in 0..random.below(4) {
                let order = order(&mut random, pose, &mut epoch);
                if !is_given(&order, &guesses) {
                    continue;
                }
                taken += 1;
                story.push(std::format!("{order:?}"));
                assert!(bench.orders.enqueue(order.clone()).is_ok());
                guesses.each(|guess| {
                    let both = [false, true].map(|otherwise| {
                        let mut after = guess;
                        after.take(&order, otherwise);
                        after
                    });
                    both.to_vec()
                });
                if matches!(order, MotionOrder::Place { .. }) && random.below(4) > 0 {
                    followed = Some(epoch);
                }
            }
            if random.below(30) == 0 {
                followed = None;
            }
            // The path arrives only in a period without orders, which could discard it.
            let quiet = taken == before;
            if quiet && random.below(4) == 0 && guesses.0.iter().all(|guess| guess.data == Data::Awaited) {
                for _ in 0..4 {
                    let position = somewhere(&mut random, -845.0);
                    let vertex = Vertex {
                        position,
                        pen: Pen::Up,
                        stroke: 0,
                    };
                    assert!(bench.vertices.enqueue(PathItem::Vertex(vertex)).is_ok());
                }
                assert!(bench.vertices.enqueue(PathItem::End).is_ok());
                story.push("the path comes".into());
                guesses.each(|guess| {
                    let mut after = guess;
                    after.bring_path();
                    vec![after]
                });
            }
            let report = bench.release(followed);
            let seen = Progress {
                idle: report.idle,
                held: report.held,
                ..Progress::default()
            };
            guesses.each(|guess| {
                let mut after = vec![guess];
                // Setpoints that are not followed fill the ring; a short motion may end in it.
                if guess.epoch.is_some() {
                    let mut arrived = guess;
                    arrived.arrive();
                    after.push(arrived);
                }
                after
            });
            let before = guesses.0.clone();
            guesses.0.retain(|guess| guess.progress() == seen);
            story.push(std::format!("{seen:?}"));
            let last = story.len().saturating_sub(20);
            assert!(
                !guesses.0.is_empty(),
                "seed {seed}: after {:#?}\n{report:?} is none of {before:?}",
                &story[last..]
            );
        }
        // A motion that is followed and not disturbed ends.
        if followed == Some(epoch) && guesses.0.iter().all(|guess| guess.epoch == followed) {
            let awaits = guesses
                .0
                .iter()
                .all(|guess| matches!(guess.data, Data::Awaited | Data::Held));
            let ends = (0..1_000).any(|_| {
                let report = bench.release(followed);
                report.idle || report.held || awaits
            });
            assert!(ends, "seed {seed}: {:?}", guesses.0);
            arrivals += 1;
        }
        (taken, arrivals)
    }

    #[test]
    fn the_trajectory_of_the_search_allows_whatever_the_real_one_does() {
        let results = (1..=60).map(walk);
        let (taken, arrivals) = results.fold((0, 0), |sum, one| (sum.0 + one.0, sum.1 + one.1));
        println!("60 seeds, {taken} orders, {arrivals} ends watched");
        assert!(taken > 5_000 && arrivals > 10, "{taken} {arrivals}");
    }

    #[test]
    fn a_motion_whose_setpoints_nobody_takes_never_ends() {
        let config = Config::default();
        let pose = pose(&config);
        let target = Position { x_mm: 50.0, ..ABOVE };
        let mut bench = Bench::new();
        for order in [
            MotionOrder::Configure(config.motion_settings()),
            MotionOrder::Place { pose, epoch: 1 },
            MotionOrder::Command(MotionCommand::MoveTo(target)),
        ] {
            assert!(bench.orders.enqueue(order).is_ok());
        }
        assert!((0..1_000).all(|_| !bench.release(None).idle));
        assert!((0..1_000).any(|_| bench.release(Some(1)).idle));
    }
}
