//! A job over a port by the wall clock.

use super::error::JobError;
use super::progress::Progress;
use super::{Control, Job, JobEvent};
use crate::link::port::{Line, Port, PortError};
use std::fmt;

/// Time between two reports of progress, ms.
const PROGRESS_MS: u64 = 100;

/// Why a job over a port ended early.
#[derive(Debug)]
pub enum OverPortError {
    /// The job failed.
    Job(Box<JobError>),
    /// The port failed.
    Port(PortError),
}

impl fmt::Display for OverPortError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Job(error) => error.fmt(f),
            Self::Port(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for OverPortError {}

/// What a running job reports.
#[derive(Clone, Copy, Debug)]
pub enum Show<'a> {
    /// Something happened.
    Event(&'a JobEvent),
    /// Progress of the drawing, ten times a second.
    Progress(&'a Progress),
}

/// Runs a job over a port by the wall clock until it ends; [`Job::into_report`] returns the collected data.
///
/// Controls returned by `control` are carried out at once.
///
/// # Errors
/// The job's error, or the port's.
pub fn run_job(
    port: Port,
    job: &mut Job,
    control: &mut dyn FnMut() -> Option<Control>,
    show: &mut dyn FnMut(Show<'_>),
) -> Result<(), OverPortError> {
    let mut line = Line::start(port);
    let mut shown_ms = 0;
    loop {
        let now_ms = line
            .exchange(|now_ms, incoming, outgoing, room| {
                while let Some(control) = control() {
                    job.control(control);
                }
                job.step(now_ms, incoming, outgoing, room);
            })
            .map_err(OverPortError::Port)?;
        while let Some(event) = job.next_event() {
            show(Show::Event(&event));
        }
        let outcome = job.outcome().copied();
        if outcome.is_some() || now_ms.saturating_sub(shown_ms) >= PROGRESS_MS {
            shown_ms = now_ms;
            show(Show::Progress(&job.progress()));
        }
        if let Some(outcome) = outcome {
            return outcome.map_err(|error| OverPortError::Job(Box::new(error)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::JobOptions;
    use crate::link::port::PortName;
    use crate::link::rig::{Rig, path, serve};
    use etherpen::config::Config;
    use std::net::TcpListener;
    use std::os::unix::net::UnixListener;
    use std::thread;

    fn job(count: usize) -> Job {
        Job::draw(Config::default(), path(count), JobOptions::default())
    }

    #[test]
    fn a_drawing_goes_over_a_socket_by_the_wall_clock() {
        let place = std::env::temp_dir().join(format!("etherpen-port-{}", std::process::id()));
        let _ = std::fs::remove_file(&place);
        let listener = UnixListener::bind(&place).unwrap();
        let firmware = thread::spawn(move || {
            let mut rig = Rig::new(1, 0);
            serve(&mut rig, &listener.accept().unwrap().0);
            rig
        });
        let port = Port::open(&format!("unix:{}", place.display()).parse().unwrap()).unwrap();
        let (mut job, mut last) = (job(100), Progress::default());
        run_job(port, &mut job, &mut || None, &mut |show| {
            if let Show::Progress(progress) = show {
                last = *progress;
            }
        })
        .unwrap();
        std::fs::remove_file(&place).unwrap();
        assert_eq!(firmware.join().unwrap().vertices, path(100));
        assert_eq!((last.vertices, last.vertices_total), (100, 100));
    }

    #[test]
    fn a_port_that_the_other_side_closes_is_an_error_at_once() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let name = PortName::Tcp(listener.local_addr().unwrap().to_string());
        let port = Port::open(&name).unwrap();
        drop(listener.accept().unwrap());
        let error = run_job(port, &mut job(1), &mut || None, &mut |_| {}).unwrap_err();
        assert!(matches!(
            error,
            OverPortError::Port(PortError::Closed { .. } | PortError::Failed { .. })
        ));
    }
}
