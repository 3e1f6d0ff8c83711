//! Transmission to a viewer: state changes, and pictures as often as its connection can carry.
//!
//! Invariant: a slow viewer gets the newest state, each column of its plots once, and the number of pictures that it
//! missed.

use super::ranges::Parts;
use super::{CLOSE_POLICY, Viewer, Watched, You};
use crate::console::capture::Caught;
use crate::console::history::Decimator;
use crate::console::lock;
use crate::console::messages::{self, PathUse, PictureUse, section};
use axum::extract::ws::{CloseFrame, Message, WebSocket};
use etherpen::messages::PathVertex;
use futures_util::SinkExt;
use futures_util::stream::SplitSink;
use serde::Serialize;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Time between two pictures.
const PICTURE: Duration = Duration::from_millis(33);
/// Longest time to send a message, after which the viewer counts as gone. A viewer without the token gets less.
const SEND_MAX: Duration = Duration::from_secs(20);
const SEND_GUEST_MAX: Duration = Duration::from_secs(5);
/// Most milliseconds by which a plot grows at once.
const ROWS_AT_ONCE: usize = 4_000;
/// Most vertices of a path that are sent.
const VERTICES_MAX: usize = 60_000;

/// State of a viewer's trigger, as sent to it.
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

/// State already sent to a viewer.
#[derive(Default)]
struct Sent {
    version: u64,
    log: u64,
    job: Option<u64>,
    preview: Option<u64>,
    photograph: Option<u64>,
    /// Number of the last variant.
    variant: u64,
    live: Option<Live>,
    parts: Option<Parts>,
    skipped: u64,
    skipped_told: u64,
    fired: Option<bool>,
}

/// Sends until the viewer leaves.
pub(super) async fn write(mut sink: SplitSink<WebSocket, Message>, viewer: Arc<Viewer>) {
    let mut changed = viewer.console.changed.subscribe();
    let mut sent = Sent::default();
    let mut picture_at = Instant::now();
    loop {
        let due = Instant::now() >= picture_at;
        let (mut messages, watch, closing) = viewer.gather(&mut sent, due);
        match watch {
            Some(watched) => messages.extend(viewer.clone().begin(&mut sent, watched).await),
            None if due => messages.extend(viewer.grow(&mut sent)),
            None => {}
        }
        messages.extend(viewer.next_part(&mut sent).await);
        let begun = Instant::now();
        let longest = if viewer.may_command() { SEND_MAX } else { SEND_GUEST_MAX };
        for message in messages {
            match tokio::time::timeout(longest, sink.send(message)).await {
                Ok(Ok(())) => {}
                Ok(Err(_)) | Err(_) => return,
            }
        }
        if let Some(reason) = closing {
            let frame = CloseFrame {
                code: CLOSE_POLICY,
                reason: reason.into(),
            };
            // The viewer leaves in any case.
            let _ = tokio::time::timeout(Duration::from_secs(1), sink.send(Message::Close(Some(frame)))).await;
            return;
        }
        if due {
            picture_at = Instant::now() + PICTURE;
            sent.skipped += (begun.elapsed().as_millis() / PICTURE.as_millis()) as u64;
        }
        if sent.parts.is_some() {
            tokio::task::yield_now().await;
            continue;
        }
        tokio::select! {
            () = tokio::time::sleep_until(picture_at.into()) => {}
            result = changed.changed() => if result.is_err() { return },
            () = viewer.awake.notified() => {}
        }
    }
}

impl Viewer {
    /// Everything to send now; pictures only when they are due.
    fn gather(&self, sent: &mut Sent, picture: bool) -> (Vec<Message>, Option<Watched>, Option<&'static str>) {
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
        self.gather_pictures(sent, &mut messages);
        self.gather_capture(sent, fired, &mut messages);
        let (watch, closing) = {
            let mut mail = lock(&self.mail);
            messages.extend(mail.answers.drain(..));
            (mail.watch.take(), mail.closing)
        };
        if sent.skipped > sent.skipped_told && picture {
            sent.skipped_told = sent.skipped;
            let you = You {
                id: self.id,
                may_command: self.may_command(),
                skipped: sent.skipped,
            };
            messages.push(text(&section("you", &you)));
        }
        (messages, watch, closing)
    }

    /// The next part of a requested range, computed in another thread.
    async fn next_part(&self, sent: &mut Sent) -> Option<Message> {
        let mut parts = match sent.parts.take() {
            Some(parts) => parts,
            None => {
                let wanted = lock(&self.mail).range.take()?;
                Parts::new(wanted, &self.console.hub().seen_by(self.id))
            }
        };
        let computed = tokio::task::spawn_blocking(move || {
            let (bytes, is_last) = parts.next();
            (bytes, (!is_last).then_some(parts))
        });
        let (bytes, rest) = computed.await.ok()?;
        sent.parts = rest;
        Some(Message::Binary(bytes.into()))
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

    fn gather_pictures(&self, sent: &mut Sent, messages: &mut Vec<Message>) {
        let photograph = self.console.photograph();
        if let Some((number, file)) = photograph.filter(|(number, _)| sent.photograph != Some(*number)) {
            sent.photograph = Some(number);
            let bytes = messages::picture(PictureUse::Photograph, number, &file);
            messages.push(Message::Binary(bytes.into()));
        }
        for (number, file) in self.console.variants_since(sent.variant) {
            sent.variant = number;
            let bytes = messages::picture(PictureUse::Variant, number, &file);
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
            self.console.hub().keep(self.id, snapshot);
            messages.push(text(&section("capture", &CaptureView::caught(caught))));
        }
    }

    /// A new plot: its whole window so far, computed in another thread.
    async fn begin(self: Arc<Self>, sent: &mut Sent, watched: Watched) -> Option<Message> {
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
        let count = signals.len();
        let computed = tokio::task::spawn_blocking(move || {
            let mut decimator = Decimator::new(signals, bucket_ms);
            let now_ms = snapshot.last_ms();
            let rows = snapshot.rows(now_ms.saturating_sub(window_ms), u64::MAX);
            let buckets: Vec<_> = rows.filter_map(|row| decimator.push(row)).collect();
            (messages::columns(id, 1, count, bucket_ms, &buckets), decimator)
        });
        let (bytes, decimator) = computed.await.ok()?;
        sent.live = Some(Live {
            id,
            decimator,
            signals: count,
            next,
        });
        Some(Message::Binary(bytes.into()))
    }

    /// The growth of a plot since the last call.
    fn grow(&self, sent: &mut Sent) -> Option<Message> {
        let live = sent.live.as_mut()?;
        let (from, rows) = self.console.hub().history().some_since(live.next, ROWS_AT_ONCE);
        live.next = from + rows.len() as u64;
        let buckets: Vec<_> = rows.iter().filter_map(|row| live.decimator.push(row)).collect();
        let bucket_ms = live.decimator.bucket_ms();
        (!buckets.is_empty())
            .then(|| Message::Binary(messages::columns(live.id, 0, live.signals, bucket_ms, &buckets).into()))
    }
}

pub(super) fn text(text: &Arc<str>) -> Message {
    Message::Text((&**text).into())
}
