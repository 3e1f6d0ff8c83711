//! Episodes in which the program's own jobs draw: the program is killed, its computer loses its supply, its log is damaged, and
//! somebody goes on with `--resume`, or from the beginning on a new sheet where the program says so.
//!
//! The judge is the sheet: a drawing of which the program says that it is drawn has ink on all of its lines.

mod log;

use super::episode::{Episode, Event, Mishap, What};
use super::ink;
use super::judge::ink_limit_mm;
use super::line::Line;
use super::world::World;
use super::{Failure, LIMIT_MS, Rule, Run};
use crate::drawing::preparation::wire::from_wire;
use crate::error::ProgramError;
use crate::job::error::{JobError, Phase};
use crate::job::history::hash_text;
use crate::job::logged::{Logged, Written};
use crate::job::resume::{self, MachineState, ResumePlan, begin_record_in, last_in};
use crate::job::{Control, Job, JobEvent, JobOptions, Ready, Task, path_hash};
use crate::link::port::PortName;
use crate::planning::planned_s;
use crate::simulation::{self, Host, Surroundings};
use etherpen::application::Mode;
use etherpen::config::Config;
use etherpen::messages::{Command, PathVertex};
use etherpen::robots::JointAngles;
use log::Log;
use std::path::Path;
use std::time::Duration;

/// Longest wait for the state of a path that the firmware holds, ms.
const PATH_MAX_MS: u32 = 500;
/// Time between two looks at the progress, ms.
const PROGRESS_MS: u32 = 100;
/// Longest time from the healing until the present drawing is drawn, without the drawing itself, ms.
const LIVENESS_MAX_MS: u32 = 60_000;
/// How often a drawing may be begun anew behind the healing, by its duration.
const BEGINNINGS: f64 = 3.0;
/// The file that is drawn; it is never opened.
const FILE: &str = "figure.svg";

/// What the program does.
enum Doing {
    /// It does not run; another one is started at a time, ms.
    Nothing { until_ms: u32 },
    /// It asks for the state of the machine, which it has known since a time, ms.
    Looking { known_ms: Option<u32> },
    /// It draws.
    Drawing { logged: Box<Logged> },
    /// It ends what the machine still does, or homes it.
    Preparing,
}

/// What a person does next.
enum Next {
    /// Draws what is left.
    Resume(Box<ResumePlan>),
    /// Draws from the beginning, on a new sheet.
    Anew,
    /// Ends what the machine holds.
    Cancel,
    /// Tries again later.
    Wait,
    /// The program says that everything is drawn.
    Believe,
}

/// The person, the program and the log.
struct Desk<'e> {
    episode: &'e Episode,
    config: Config,
    world: World,
    /// The paths that are drawn one after the other, and the number of the present one.
    paths: Vec<Vec<PathVertex>>,
    number: usize,
    log: Log,
    up: Line,
    down: Line,
    job: Option<Job>,
    /// When the job began, ms.
    since_ms: u32,
    connections: u32,
    doing: Doing,
    stands_until_ms: u32,
    away_until_ms: u32,
    stop_until_ms: u32,
    /// Whether a quick stop, which may leave the path, was on this sheet.
    was_stopped: bool,
    /// Points of ink on earlier sheets.
    inked: usize,
    /// Of the sheet before: points of ink on earlier sheets, whether a quick stop was on it, and the number of its drawing.
    before: (usize, bool, usize),
    /// Whether the drawing on this sheet is in the log; then a person resumes.
    has_begun: bool,
    /// Whether the board has begun to draw on this sheet.
    has_drawn: bool,
    /// Whether an end of a drawing could not be written: a person who was told so does not go on with that drawing on an empty sheet.
    is_end_unwritten: bool,
    next_event: usize,
    /// The time at which everything is over at the latest, ms; known once everything is healed.
    over_ms: Option<u32>,
    now_ms: u32,
    is_over: bool,
    failure: Option<Failure>,
}

/// Runs an episode.
pub(super) fn run(episode: &Episode, config: Config, world: World) -> Run {
    let log = match Log::new() {
        Ok(log) => log,
        Err(cause) => return Run::failed(Rule::Episode, format!("the log cannot be written: {cause}")),
    };
    let mut desk = Desk::new(episode, config, world.clone(), log);
    let mut segment = world;
    let passed_ms = simulation::run(&mut segment, &mut desk, LIMIT_MS);
    Run {
        passed_ms,
        resets: 0,
        failure: desk.failure,
    }
}

impl<'e> Desk<'e> {
    fn new(episode: &'e Episode, config: Config, world: World, log: Log) -> Self {
        let mut paths: Vec<_> = episode.figures.iter().map(|figure| figure.path(&config)).collect();
        paths.retain(|path| !path.is_empty());
        Self {
            episode,
            config,
            world,
            is_over: paths.is_empty(),
            paths,
            number: 0,
            log,
            up: Line::new(episode.seed),
            down: Line::new(!episode.seed),
            job: None,
            since_ms: 0,
            connections: 0,
            doing: Doing::Nothing { until_ms: 0 },
            stands_until_ms: 0,
            away_until_ms: 0,
            stop_until_ms: 0,
            was_stopped: false,
            inked: 0,
            before: (0, false, usize::MAX),
            has_begun: false,
            has_drawn: false,
            is_end_unwritten: false,
            next_event: 0,
            over_ms: None,
            now_ms: 0,
            failure: None,
        }
    }

    fn fail(&mut self, rule: Rule, text: String) {
        let time_ms = self.now_ms;
        self.failure.get_or_insert(Failure { time_ms, rule, text });
        self.is_over = true;
    }

    /// Fails if the log's folder, which is this program's, cannot be used.
    fn on_disk(&mut self, result: std::io::Result<()>) {
        if let Err(cause) = result {
            self.fail(Rule::Episode, format!("the log: {cause}"));
        }
    }

    fn happen(&mut self, event: &Event) {
        let until = |ms: u32| event.at_ms.saturating_add(ms);
        match &event.what {
            What::Unplug(ms) => {
                self.up.unplug(until(*ms));
                self.down.unplug(until(*ms));
            }
            What::Noise(ms, per_mille) => {
                self.up.disturb(until(*ms), *per_mille);
                self.down.disturb(until(*ms), *per_mille);
            }
            What::StopInput(ms) => self.stop_until_ms = until(*ms),
            What::Program(mishap) => self.suffer(mishap, event.at_ms),
            _ => {}
        }
    }

    fn suffer(&mut self, mishap: &Mishap, at_ms: u32) {
        let is_away = self.now_ms < self.away_until_ms;
        if !is_away || matches!(mishap, Mishap::Away(_)) {
            let suffered = self.log.suffer(mishap);
            self.on_disk(suffered);
        }
        match *mishap {
            Mishap::Killed(ms) | Mishap::KilledWriting(_, ms) | Mishap::PowerCut(ms) => {
                self.leave(at_ms.saturating_add(ms));
            }
            Mishap::Stands(ms) => self.stands_until_ms = at_ms.saturating_add(ms),
            Mishap::Away(ms) => self.away_until_ms = self.away_until_ms.max(at_ms.saturating_add(ms)),
            Mishap::Cut(_) | Mishap::Changed(..) | Mishap::Zeroed(_) | Mishap::Removed => {}
        }
    }

    /// The program is gone until a time, ms.
    fn leave(&mut self, until_ms: u32) {
        self.job = None;
        self.doing = Doing::Nothing { until_ms };
    }

    /// Tries again after a pause.
    fn pause(&mut self) {
        self.leave(self.now_ms.saturating_add(self.episode.patience_ms));
    }

    fn heal(&mut self) {
        self.over_ms = Some(self.latest_ms());
        (self.stop_until_ms, self.stands_until_ms, self.away_until_ms) = (0, 0, 0);
        self.up.heal();
        self.down.heal();
    }

    /// Starts the program.
    fn start(&mut self) {
        self.connections += 1;
        let options = JobOptions {
            session: self.connections,
            acknowledge: true,
            ..JobOptions::default()
        };
        self.job = Some(Job::new(self.config.clone(), Task::Look, options));
        self.since_ms = self.now_ms;
        self.doing = Doing::Looking { known_ms: None };
    }

    /// What is to be done with a machine whose state the program knows.
    fn decide(&self) -> Result<Next, String> {
        if !self.has_begun || self.is_end_unwritten && self.is_empty() {
            return Ok(Next::Anew);
        }
        let Some(job) = &self.job else { return Ok(Next::Wait) };
        let machine = MachineState {
            welcome: job.welcome().cloned(),
            status: job.status().cloned(),
            path: job.held_path().copied(),
        };
        let hash = hash_text(path_hash(self.path()));
        let found = last_in(&self.log.folder(), &hash, Path::new(FILE));
        match found.and_then(|found| resume::plan(found, &machine, &self.config, self.path())) {
            Ok(plan) => Ok(Next::Resume(Box::new(plan))),
            Err(said) => understood(&said),
        }
    }

    fn act(&mut self, next: Next) {
        match next {
            Next::Resume(plan) => {
                let (inked, was_stopped, number) = self.before;
                // What the board has executed before it began on this sheet is on the one before, as the program says.
                if plan.drawing.held && !self.has_drawn && number == self.number && self.has_executed() {
                    self.inked = inked;
                    (self.was_stopped, self.has_drawn) = (self.was_stopped || was_stopped, true);
                }
                self.draw(*plan);
            }
            Next::Anew => {
                self.new_sheet();
                let port = PortName::Serial("/dev/ttyACM0".into());
                let file = Path::new(FILE);
                // Without a log the drawing is drawn all the same.
                let record = begin_record_in(&self.log.folder(), file, &(), &port, &self.config, self.path()).ok();
                // A person who was told so does not resume.
                self.has_begun = record.is_some();
                self.draw(ResumePlan::whole(self.path(), record));
            }
            Next::Cancel => {
                if let Some(job) = &mut self.job {
                    job.begin(Task::Rest);
                }
                self.doing = Doing::Preparing;
            }
            Next::Wait => self.pause(),
            // An earlier copy is meant.
            Next::Believe if !self.has_drawn && self.is_empty() => self.act(Next::Anew),
            Next::Believe => self.believe("nothing is left to draw"),
        }
    }

    /// The present drawing.
    fn path(&self) -> &[PathVertex] {
        self.paths.get(self.number).map_or(&[], Vec::as_slice)
    }

    /// Whether nothing was drawn on this sheet.
    fn is_empty(&self) -> bool {
        let (from, limit_mm) = (self.inked, ink_limit_mm(&self.config));
        self.world.look(|cell, _| ink::is_empty(cell.ink(), from, limit_mm))
    }

    /// Points of ink on all sheets.
    fn points(&self) -> usize {
        self.world.look(|cell, _| ink::points(cell.ink()))
    }

    /// Whether the board has executed a part of the path that it holds.
    fn has_executed(&self) -> bool {
        let held = self.job.as_ref().and_then(Job::held_path);
        held.is_some_and(|path| path.executed > 0)
    }

    fn new_sheet(&mut self) {
        self.before = (self.inked, self.was_stopped, self.number);
        self.inked = self.points();
        (self.was_stopped, self.has_drawn) = (self.stop_shows_open(), false);
    }

    fn draw(&mut self, plan: ResumePlan) {
        let mut logged = Logged::begin(&self.config, self.path(), plan);
        self.log.note_synced();
        if let Some(job) = &mut self.job {
            if let Some(welcome) = job.welcome() {
                logged.connected(&welcome.clone());
            }
            job.begin(Task::Draw(logged.plan().drawing.clone()));
        }
        self.doing = Doing::Drawing {
            logged: Box::new(logged),
        };
    }

    /// The program says that the drawing is drawn.
    fn believe(&mut self, said: &str) {
        let (inked, limit_mm, paper) = (self.inked, ink_limit_mm(&self.config), self.config.paper);
        let compare = if self.was_stopped {
            ink::check_whole
        } else {
            ink::compare
        };
        let path = self.path();
        let verdict = self
            .world
            .look(|cell, _| compare(cell.ink(), inked, path, &paper, limit_mm));
        if let Err(text) = verdict {
            return self.fail(Rule::Ink, format!("the program says: {said}; {text}"));
        }
        if self.over_ms.is_none() {
            self.number = (self.number + 1) % self.paths.len();
            self.has_begun = false;
            return self.pause();
        }
        if !self.log.has_the_other() {
            return self.fail(Rule::Ink, "the log has lost another drawing".to_owned());
        }
        self.is_over = true;
    }

    fn stop_shows_open(&self) -> bool {
        self.now_ms < self.stop_until_ms
    }

    /// Goes on with what the program does, after its job's step.
    fn go_on(&mut self) {
        let Some(job) = &mut self.job else { return };
        let outcome = job.outcome().copied();
        let lost = job.broken().is_some();
        match &mut self.doing {
            Doing::Nothing { .. } => {}
            Doing::Looking { .. } | Doing::Preparing if lost => self.pause(),
            Doing::Looking { known_ms } => {
                if outcome.is_none() {
                    return;
                }
                let known_ms = *known_ms.get_or_insert(self.now_ms);
                if job.held_path().is_none() && self.now_ms < known_ms + PATH_MAX_MS {
                    return;
                }
                match self.decide() {
                    Ok(next) => self.act(next),
                    Err(text) => self.fail(Rule::Episode, text),
                }
            }
            Doing::Preparing if outcome.is_some() => self.pause(),
            Doing::Preparing => {}
            Doing::Drawing { .. } => self.watch_drawing(outcome),
        }
    }

    /// Keeps the log of the drawing, and takes its end.
    fn watch_drawing(&mut self, outcome: Option<Result<(), JobError>>) {
        let (Some(job), Doing::Drawing { logged }) = (&mut self.job, &mut self.doing) else {
            return;
        };
        while let Some(event) = job.next_event() {
            if event != JobEvent::Phase(Phase::Drawing) {
                continue;
            }
            self.has_drawn = true;
            // A newer entry has ink from now on.
            self.is_end_unwritten &= !self.has_begun;
            if logged.draws() == Some(Written::Synced) {
                self.log.note_synced();
            }
        }
        let Some(outcome) = outcome else {
            let is_held = job.status().is_some_and(|status| status.mode == Mode::Holding);
            if is_held && self.now_ms.is_multiple_of(self.episode.patience_ms.max(1)) {
                job.control(Control::Resume);
            }
            let since_ms = self.now_ms - self.since_ms;
            if since_ms.is_multiple_of(PROGRESS_MS) {
                let whole = logged.whole(&job.progress());
                let written = logged.advance(&whole, Duration::from_millis(since_ms.into()));
                if written == Some(Written::Synced) {
                    self.log.note_synced();
                }
            }
            return;
        };
        let text = outcome.map_err(|error| error.to_string());
        let said = text.as_ref().map(|&()| ()).map_err(String::as_str);
        // Where the log cannot be written, the program says so; the drawing stays as it is.
        match logged.end(said, &job.take_report()) {
            Ok(()) => self.log.note_synced(),
            Err(_) => self.is_end_unwritten = true,
        }
        match outcome {
            Ok(()) => self.believe("drawn"),
            Err(JobError::NotReferenced) => {
                // Without switches, a person measures where the robot is.
                let pose = JointAngles(self.world.truth().angles_rad);
                job.begin(match self.config.has_home_switches() {
                    true => Task::Prepare(Ready::Homed),
                    false => Task::Tell(Command::HomeAt { pose, position: None }),
                });
                self.doing = Doing::Preparing;
            }
            Err(_) => self.pause(),
        }
    }

    /// The time at which the present drawing is over at the latest if nothing disturbs it any more, ms.
    fn latest_ms(&self) -> u32 {
        let path: Vec<_> = self.path().iter().map(from_wire).collect();
        let drawing_ms = BEGINNINGS * 1e3 * planned_s(&self.config, &path);
        self.episode
            .duration_ms
            .saturating_add(LIVENESS_MAX_MS)
            .saturating_add(drawing_ms as u32)
    }
}

/// What a person does who reads why the program does not resume.
fn understood(said: &ProgramError) -> Result<Next, String> {
    let says = |words: &str| said.message.contains(words);
    match () {
        () if says("is damaged") || says("knows no unfinished drawing") => Ok(Next::Anew),
        () if says("nothing is left to draw") => Ok(Next::Believe),
        () if says("etherpen cancel") => Ok(Next::Cancel),
        () if says("the log of jobs cannot be read") => Ok(Next::Wait),
        () => Err(format!("nobody knows what to do: {}", said.message)),
    }
}

impl Host for Desk<'_> {
    fn exchange(&mut self, ms: u32, from_firmware: &[u8], to_firmware: &mut Vec<u8>, room: usize) {
        self.now_ms = ms;
        while let Some(event) = self
            .episode
            .events
            .get(self.next_event)
            .filter(|event| event.at_ms <= ms)
        {
            self.next_event += 1;
            self.happen(event);
        }
        if self.over_ms.is_none() && ms >= self.episode.duration_ms {
            self.heal();
        }
        if ms >= self.away_until_ms {
            let back = self.log.come_back();
            self.on_disk(back);
        }
        self.was_stopped |= self.stop_shows_open();
        if let Doing::Nothing { until_ms } = self.doing
            && ms >= until_ms
        {
            self.start();
        }
        if ms >= self.stands_until_ms
            && let Some(job) = &mut self.job
        {
            let mut arrived = from_firmware.to_vec();
            self.up.carry(ms, &mut arrived);
            job.step(u64::from(ms - self.since_ms), &arrived, to_firmware, room);
            self.down.carry(ms, to_firmware);
            self.go_on();
        }
        if self.over_ms.is_some_and(|over_ms| ms > over_ms) {
            let status = self.job.as_ref().and_then(Job::status);
            self.fail(Rule::Liveness, format!("healed, and no drawing came: {status:?}"));
        }
    }

    fn surroundings(&mut self) -> Surroundings {
        Surroundings {
            stop_shows_open: self.stop_shows_open(),
            ..Surroundings::default()
        }
    }

    fn is_over(&self) -> bool {
        self.is_over
    }
}

#[cfg(test)]
mod tests {
    use super::super::episode::Figure;
    use super::super::generate::{Profile, episode};
    use super::super::machine::{DEFAULT_MACHINE, Machine};
    use super::super::prepared;
    use super::*;
    use crate::job::history::list;

    /// Somebody kills the program in the first stroke, lets the machine forget its drawing, and writes a log that is whole and
    /// says that more was drawn.
    struct Forger<'e> {
        desk: Desk<'e>,
        at_ms: u32,
    }

    impl Host for Forger<'_> {
        fn exchange(&mut self, ms: u32, from_firmware: &[u8], to_firmware: &mut Vec<u8>, room: usize) {
            if ms == self.at_ms {
                self.desk.leave(ms + 300);
                (self.desk.stop_until_ms, self.desk.was_stopped) = (ms + 100, true);
                let mut records = list(&self.desk.log.folder()).expect("a log");
                let record = records.last_mut().expect("an entry");
                record.entry.executed = self.desk.path().len() as u32 - 3;
                record.save().expect("the entry");
            }
            self.desk.exchange(ms, from_firmware, to_firmware, room);
        }

        fn surroundings(&mut self) -> Surroundings {
            self.desk.surroundings()
        }

        fn is_over(&self) -> bool {
            self.desk.is_over()
        }
    }

    #[test]
    fn a_log_that_says_too_much_is_found_from_the_ink() {
        let machine = Machine::load(DEFAULT_MACHINE).expect("a bundled machine");
        let line = |y_um: i32| vec![[-40_000, y_um], [40_000, y_um]];
        let episode = Episode {
            figures: vec![Figure(vec![line(-20_000), line(0), line(20_000)])],
            config: std::collections::BTreeMap::new(),
            events: Vec::new(),
            ..episode(&machine, 1, Profile::Files)
        };
        for (at_ms, is_found) in [(1_500, true), (u32::MAX, false)] {
            let (config, world) = prepared(&episode).expect("an episode");
            let desk = Desk::new(&episode, config, world.clone(), Log::new().expect("a log"));
            let mut forger = Forger { desk, at_ms };
            simulation::run(&mut world.clone(), &mut forger, LIMIT_MS);
            let failure = forger.desk.failure;
            let is_of_ink = failure.as_ref().is_some_and(|failure| failure.rule == Rule::Ink);
            assert_eq!(is_of_ink, is_found, "{at_ms} ms: {failure:?}");
        }
    }
}
