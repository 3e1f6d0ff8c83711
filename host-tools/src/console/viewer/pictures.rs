//! What is sent to a viewer: what has changed, and pictures as often as its line takes them.
//!
//! Invariant: a viewer that is slow gets the newest of everything, each column of its plots once, and is told how many
//! pictures it has missed.

use super::{CLOSE_POLICY, Viewer, Watched, You};
use crate::console::capture::Caught;
use crate::console::history::{Bucket, Decimator, Snapshot};
use crate::console::lock;
use crate::console::messages::{self, PathUse, section};
use axum::extract::ws::{CloseFrame, Message, WebSocket};
use etherpen::link::protocol::PathVertex;
use futures_util::SinkExt;
use futures_util::stream::SplitSink;
use serde::Serialize;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Time between two pictures.
const PICTURE: Duration = Duration::from_millis(33);
/// Longest time that a message may take to leave; after it the viewer counts as gone.
const SEND_MAX: Duration = Duration::from_secs(20);
/// Vertices of a path that are sent.
const VERTICES_MAX: usize = 60_000;

/// What a viewer is told of its trigger.
#[derive(Serialize)]
pub(super) struct CaptureView {
    state: &'static str,
    from_ms: u64,
    event_ms: u64,
    to_ms: u64,
}

impl CaptureView {
    pub(super) const fn armed() -> Self {
        Self {
            state: "armed",
            ..Self::idle()
        }
    }

    pub(super) const fn idle() -> Self {
        Self {
            state: "idle",
            from_ms: 0,
            event_ms: 0,
            to_ms: 0,
        }
    }

    const fn caught(caught: Caught) -> Self {
        Self {
            state: "caught",
            from_ms: caught.from_ms,
            event_ms: caught.event_ms,
            to_ms: caught.to_ms,
        }
    }
}

/// A plot that is sent as it grows.
struct Live {
    id: u32,
    decimator: Decimator,
    signals: usize,
    next: u64,
}

/// What a viewer has been sent.
#[derive(Default)]
struct Sent {
    version: u64,
    log: u64,
    job: Option<u64>,
    preview: Option<u64>,
    live: Option<Live>,
    skipped: u64,
    skipped_told: u64,
    fired: Option<bool>,
}

/// Sends until the viewer goes.
pub(super) async fn write(mut sink: SplitSink<WebSocket, Message>, viewer: Arc<Viewer>) {
    let mut changed = viewer.console.changed.subscribe();
    let mut sent = Sent::default();
    let mut picture_at = Instant::now();
    loop {
        let due = Instant::now() >= picture_at;
        let (messages, closing) = viewer.gather(&mut sent, due);
        let begun = Instant::now();
        for message in messages {
            match tokio::time::timeout(SEND_MAX, sink.send(message)).await {
                Ok(Ok(())) => {}
                Ok(Err(_)) | Err(_) => return,
            }
        }
        if let Some(reason) = closing {
            let frame = CloseFrame {
                code: CLOSE_POLICY,
                reason: reason.into(),
            };
            // It goes either way.
            let _ = tokio::time::timeout(Duration::from_secs(1), sink.send(Message::Close(Some(frame)))).await;
            return;
        }
        if due {
            picture_at = Instant::now() + PICTURE;
            sent.skipped += (begun.elapsed().as_millis() / PICTURE.as_millis()) as u64;
        }
        tokio::select! {
            () = tokio::time::sleep_until(picture_at.into()) => {}
            result = changed.changed() => if result.is_err() { return },
            () = viewer.awake.notified() => {}
        }
    }
}

impl Viewer {
    /// Everything that is to be sent now; pictures only when they are due.
    fn gather(&self, sent: &mut Sent, picture: bool) -> (Vec<Message>, Option<&'static str>) {
        let mut messages = Vec::new();
        let hub = self.console.hub();
        for (version, news) in hub.news_since(sent.version) {
            sent.version = version;
            messages.push(text(&news));
        }
        let (lines, next) = hub.log_since(sent.log);
        if !lines.is_empty() {
            sent.log = next;
            messages.push(text(&section("log", &lines)));
        }
        let on_sheet = hub.jobs.on_sheet();
        let pose = if picture { hub.pose() } else { None };
        let fired = hub.capture_state(self.id);
        drop(hub);
        messages.extend(pose.as_ref().map(text));
        self.gather_paths(sent, on_sheet, &mut messages);
        self.gather_capture(sent, fired, &mut messages);
        let (watch, closing) = {
            let mut mail = lock(&self.mail);
            messages.extend(mail.answers.drain(..));
            (mail.watch.take(), mail.closing)
        };
        if let Some(watched) = watch {
            messages.push(self.begin(sent, watched));
        } else if picture {
            messages.extend(self.grow(sent));
        }
        if sent.skipped > sent.skipped_told && picture {
            sent.skipped_told = sent.skipped;
            let you = You {
                id: self.id,
                may_command: lock(&self.mail).commanding,
                skipped: sent.skipped,
            };
            messages.push(text(&section("you", &you)));
        }
        (messages, closing)
    }

    fn gather_paths(&self, sent: &mut Sent, on_sheet: Option<(u64, Arc<[PathVertex]>)>, messages: &mut Vec<Message>) {
        if on_sheet.as_ref().map(|(number, _)| *number) != sent.job
            && let Some((number, path)) = on_sheet
        {
            sent.job = Some(number);
            let bytes = messages::path(PathUse::Job, number, &path, VERTICES_MAX);
            messages.push(Message::Binary(bytes.into()));
        }
        let preview = lock(&self.console.preview).number;
        if sent.preview != Some(preview)
            && let Some((number, drawing)) = self.console.preview()
        {
            sent.preview = Some(number);
            let bytes = messages::path(PathUse::Preview, number, &drawing.path, VERTICES_MAX);
            messages.push(Message::Binary(bytes.into()));
        }
    }

    fn gather_capture(&self, sent: &mut Sent, fired: Option<bool>, messages: &mut Vec<Message>) {
        if sent.fired == Some(false) && fired == Some(true) {
            let fired = CaptureView {
                state: "fired",
                ..CaptureView::idle()
            };
            messages.push(text(&section("capture", &fired)));
        }
        sent.fired = fired;
        if fired.is_none() {
            return;
        }
        let caught = self.console.hub().take_caught(self.id);
        if let Some((caught, snapshot)) = caught {
            lock(&self.mail).frozen = Some(snapshot);
            messages.push(text(&section("capture", &CaptureView::caught(caught))));
        }
    }

    /// A new picture: everything of its window so far.
    fn begin(&self, sent: &mut Sent, watched: Watched) -> Message {
        let Watched {
            id,
            signals,
            window_ms,
            columns,
        } = watched;
        let bucket_ms = window_ms.div_ceil(columns).max(1);
        let (snapshot, next) = {
            let hub = self.console.hub();
            (hub.history().snapshot(), hub.history().next())
        };
        let mut decimator = Decimator::new(signals.clone(), bucket_ms);
        let now_ms = snapshot.last_ms();
        let rows = snapshot.rows(now_ms.saturating_sub(window_ms), u64::MAX);
        let buckets: Vec<_> = rows.filter_map(|row| decimator.push(row)).collect();
        sent.live = Some(Live {
            id,
            decimator,
            signals: signals.len(),
            next,
        });
        Message::Binary(messages::columns(id, 1, signals.len(), bucket_ms, &buckets).into())
    }

    /// What a picture has grown by.
    fn grow(&self, sent: &mut Sent) -> Option<Message> {
        let live = sent.live.as_mut()?;
        let (from, rows) = self.console.hub().history().since(live.next);
        live.next = from + rows.len() as u64;
        let buckets: Vec<_> = rows.iter().filter_map(|row| live.decimator.push(row)).collect();
        let bucket_ms = live.decimator.bucket_ms();
        (!buckets.is_empty())
            .then(|| Message::Binary(messages::columns(live.id, 0, live.signals, bucket_ms, &buckets).into()))
    }
}

/// Columns of a span.
pub(super) fn decimated(
    snapshot: &Snapshot,
    signals: &[usize],
    bucket_ms: u64,
    from_ms: u64,
    to_ms: u64,
) -> Vec<Bucket> {
    let mut decimator = Decimator::new(signals.to_vec(), bucket_ms);
    let mut buckets: Vec<_> = snapshot
        .rows(from_ms, to_ms)
        .filter_map(|row| decimator.push(row))
        .collect();
    buckets.extend(decimator.finish());
    buckets
}

pub(super) fn text(text: &Arc<str>) -> Message {
    Message::Text((&**text).into())
}
