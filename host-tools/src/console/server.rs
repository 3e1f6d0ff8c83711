//! The console's HTTP server: the page, a WebSocket for every viewer, and requests for files and stops.
//!
//! The thread `stop` reads the connections and answers requests for files of the page; the thread `viewers` serves all
//! other requests.
//!
//! Invariants: a request sent by another page in this browser is refused because of its origin, a request to another
//! host name because of its host. Commands need the token that was printed in the terminal, and no byte of a file is
//! read before the token was checked. Connections are bounded in number, their heads and bodies in time and length.

use super::assets::{ASSETS, POLICY};
use super::control::Change;
use super::hub::Level;
use super::messages::{FILE_BYTES_MAX, REQUEST_BYTES_MAX};
use super::preparation::PageOptions;
use super::{Console, viewer};
use axum::Router;
use axum::body::Body;
use axum::extract::ws::WebSocketUpgrade;
use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use futures_util::StreamExt;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::{Service, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use std::collections::VecDeque;
use std::io;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};
use tokio::runtime::{Builder, Handle};
use tokio::sync::watch;
use tokio::task::AbortHandle;

/// Time between two periodic checks.
const LOOK: Duration = Duration::from_millis(200);
/// Checks between two reports of the link's counters.
const LOOKS_PER_REPORT: u32 = 5;
/// Path of a stop request.
const STOP: &str = "/stop";
/// Header with the token.
const TOKEN: &str = "x-etherpen-token";
/// Header with the viewer's number.
const VIEWER: &str = "x-etherpen-viewer";
/// Header with a file's name.
const NAME: &str = "x-etherpen-name";
/// Header with the options of a drawing, as JSON.
const OPTIONS: &str = "x-etherpen-options";
/// Most bytes queued for one viewer in this process.
const WRITE_BUFFER_MAX: usize = 4 << 20;
/// Most connections beside the viewers' sockets. One more displaces the oldest that has not shown the token, or else
/// the oldest, once that one has had time for its request.
const CONNECTIONS_MAX: usize = 512;
const CONNECTION_MIN: Duration = Duration::from_millis(100);
/// Time between two checks for room.
const LOOK_FOR_ROOM: Duration = Duration::from_millis(5);
/// Longest time for the head of a request.
const HEAD_MAX: Duration = Duration::from_secs(5);
/// Longest head of a request, bytes.
const HEAD_BYTES_MAX: usize = 32 * 1024;
/// Longest pause within a file, and longest time for the whole file.
const PAUSE_MAX: Duration = Duration::from_secs(10);
const UPLOAD_MAX: Duration = Duration::from_secs(180);
/// Time before accepting connections again after this process had no resources for one.
const FULL: Duration = Duration::from_millis(50);

/// A running server; dropping it stops it.
pub struct Server {
    address: SocketAddr,
    end: watch::Sender<bool>,
    threads: Vec<JoinHandle<()>>,
}

#[derive(Clone)]
struct Door {
    console: Arc<Console>,
    address: SocketAddr,
    /// Whether a file is being uploaded.
    uploading: Arc<AtomicBool>,
    /// Runtime handle of the thread that serves the viewers.
    viewers: Handle,
}

/// Whether a connection has shown the token.
#[derive(Clone, Default)]
struct Trusted(Arc<AtomicBool>);

impl Server {
    /// Starts serving at an address; port 0 selects a free one.
    ///
    /// # Errors
    /// The address cannot be used.
    pub fn start(console: Arc<Console>, address: SocketAddr) -> io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        let address = listener.local_addr()?;
        let (end, ended) = watch::channel(false);
        // One thread computes the pictures, one after the other.
        let viewers = Builder::new_current_thread()
            .enable_all()
            .max_blocking_threads(1)
            .build()?;
        let door = Door {
            console: console.clone(),
            address,
            uploading: Arc::default(),
            viewers: viewers.handle().clone(),
        };
        let stop = Builder::new_current_thread().enable_all().build()?;
        let accepting = async move {
            if let Ok(listener) = tokio::net::TcpListener::from_std(listener) {
                accept(&listener, router(door)).await;
            }
        };
        let threads = vec![
            run("viewers", viewers, ended.clone(), look_after(console))?,
            run("stop", stop, ended, accepting)?,
        ];
        Ok(Self { address, end, threads })
    }

    /// The address on which the server listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // The server may have ended already.
        let _ = self.end.send(true);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

/// Runs a future, with everything that it spawns, in a separate thread until the server ends.
fn run(
    name: &str,
    runtime: tokio::runtime::Runtime,
    mut ended: watch::Receiver<bool>,
    work: impl Future<Output = ()> + Send + 'static,
) -> io::Result<JoinHandle<()>> {
    thread::Builder::new().name(name.to_owned()).spawn(move || {
        runtime.block_on(async move {
            tokio::select! {
                () = work => {}
                _ = ended.wait_for(|ended| *ended) => {}
            }
        });
        runtime.shutdown_background();
    })
}

/// An accepted connection.
struct Connection {
    begun: Instant,
    trusted: Trusted,
    serving: AbortHandle,
}

/// Waits until there is room for another connection; the one displaced has had some time.
async fn make_room(open: &mut VecDeque<Connection>) {
    loop {
        open.retain(|connection| !connection.serving.is_finished());
        if open.len() < CONNECTIONS_MAX {
            return;
        }
        let untrusted = |connection: &Connection| !connection.trusted.0.load(Ordering::Relaxed);
        let oldest = open.iter().position(untrusted).unwrap_or(0);
        if open
            .get(oldest)
            .is_some_and(|oldest| oldest.begun.elapsed() >= CONNECTION_MIN)
            && let Some(oldest) = open.remove(oldest)
        {
            return oldest.serving.abort();
        }
        tokio::time::sleep(LOOK_FOR_ROOM).await;
    }
}

/// Accepts connections, a bounded number of them at a time; each is served once before the next one is accepted.
async fn accept(listener: &tokio::net::TcpListener, app: Router) {
    let app = TowerToHyperService::new(app);
    let mut open: VecDeque<Connection> = VecDeque::new();
    loop {
        make_room(&mut open).await;
        let Ok((stream, _)) = listener.accept().await else {
            tokio::time::sleep(FULL).await;
            continue;
        };
        // Without this option the connection is only slower.
        let _ = stream.set_nodelay(true);
        let (app, trusted) = (app.clone(), Trusted::default());
        let shown = trusted.clone();
        let serve = service_fn(move |mut request: Request<Incoming>| {
            request.extensions_mut().insert(shown.clone());
            app.call(request)
        });
        let connection = http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(HEAD_MAX)
            .max_buf_size(HEAD_BYTES_MAX)
            .serve_connection(TokioIo::new(stream), serve)
            .with_upgrades();
        // The server does not depend on how a connection ends.
        let connection = tokio::spawn(async move { drop(connection.await) });
        open.push_back(Connection {
            begun: Instant::now(),
            trusted,
            serving: connection.abort_handle(),
        });
        tokio::task::yield_now().await;
    }
}

fn router(door: Door) -> Router {
    let mut router = Router::new();
    for asset in ASSETS {
        let answer = move || async move { ([(header::CONTENT_TYPE, asset.media)], asset.content) };
        router = router.route(asset.path, get(answer));
    }
    router
        .route("/socket", get(socket))
        .route(STOP, post(stop))
        .route("/file", post(file))
        .layer(middleware::from_fn_with_state(door.clone(), guard))
        .with_state(door)
}

/// Refuses requests that do not come from this page, and sends the page's policy to the browser.
async fn guard(State(door): State<Door>, request: Request<Body>, next: Next) -> Response {
    let host = text(request.headers(), header::HOST.as_str());
    let origin = text(request.headers(), header::ORIGIN.as_str());
    let mut response = if !is_host(host, door.address) {
        refused(StatusCode::FORBIDDEN, "this console is not known by that name")
    } else if !origin.is_empty() && origin.strip_prefix("http://") != Some(host) {
        refused(StatusCode::FORBIDDEN, "another page may not talk to this console")
    } else {
        if has_token(&door, request.headers())
            && let Some(Trusted(trusted)) = request.extensions().get()
        {
            trusted.store(true, Ordering::Relaxed);
        }
        if request.uri().path() != STOP {
            door.console.gate().begin(0).await;
        }
        next.run(request).await
    };
    let headers = response.headers_mut();
    for (name, value) in [
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::CACHE_CONTROL, "no-store"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    response
}

/// Whether a request for this host is meant for a server at this address; a foreign name that resolves to this address
/// is not.
fn is_host(host: &str, address: SocketAddr) -> bool {
    let Some((name, port)) = host.rsplit_once(':') else {
        return false;
    };
    let right_port = port.parse() == Ok(address.port());
    let here = ["127.0.0.1", "localhost", "[::1]"].contains(&name);
    right_port && (here || !address.ip().is_loopback())
}

fn text<'a>(headers: &'a HeaderMap, name: &str) -> &'a str {
    headers.get(name).and_then(|value| value.to_str().ok()).unwrap_or("")
}

fn refused(status: StatusCode, why: &'static str) -> Response {
    (status, why).into_response()
}

async fn socket(State(door): State<Door>, upgrade: WebSocketUpgrade) -> Response {
    upgrade
        .max_message_size(REQUEST_BYTES_MAX)
        .max_frame_size(REQUEST_BYTES_MAX)
        .max_write_buffer_size(WRITE_BUFFER_MAX)
        .on_upgrade(move |socket| viewer::serve(socket, door.console, door.viewers))
}

fn has_token(door: &Door, headers: &HeaderMap) -> bool {
    viewer::same(text(headers, TOKEN).as_bytes(), door.console.token.as_bytes())
}

/// A second path for a stop, beside the WebSocket.
async fn stop(State(door): State<Door>, headers: HeaderMap) -> Response {
    if !has_token(&door, &headers) {
        return refused(StatusCode::FORBIDDEN, "wrong token");
    }
    door.console.stop("a page");
    StatusCode::ACCEPTED.into_response()
}

/// Takes a file, one at a time; refuses a sender without permission before reading any of it.
async fn file(State(door): State<Door>, request: Request) -> Response {
    let (head, body) = request.into_parts();
    let headers = head.headers;
    if !has_token(&door, &headers) {
        return refused(StatusCode::FORBIDDEN, "wrong token");
    }
    let viewer = text(&headers, VIEWER).parse().unwrap_or(0);
    let console = door.console.clone();
    // This thread does not wait for a lock of the viewers.
    let asking = door
        .viewers
        .spawn(async move { console.hub().control.is_held_by(viewer) });
    if !asking.await.unwrap_or(false) {
        return refused(StatusCode::CONFLICT, "you do not have control; take it first");
    }
    if door.uploading.swap(true, Ordering::Relaxed) {
        return refused(StatusCode::CONFLICT, "another file is being sent; wait a moment");
    }
    let _uploading = Uploading(door.uploading.clone());
    let length = text(&headers, header::CONTENT_LENGTH.as_str()).parse().unwrap_or(0);
    let content = match tokio::time::timeout(UPLOAD_MAX, content_of(body, length)).await {
        Ok(Ok(content)) => content,
        Ok(Err(refusal)) => return refusal.into_response(),
        Err(_) => return refused(StatusCode::REQUEST_TIMEOUT, "the file took too long"),
    };
    let name = decoded(text(&headers, NAME));
    let wishes = match PageOptions::parse(&decoded(text(&headers, OPTIONS))) {
        Ok(wishes) => wishes,
        Err(why) => return (StatusCode::BAD_REQUEST, why).into_response(),
    };
    let console = door.console.clone();
    let preparing = door.viewers.spawn(async move {
        // Somebody else may have taken over while the file came.
        let holds = console.hub().control.is_held_by(viewer);
        match holds {
            true => console.prepare(&name, wishes, content),
            false => Err("you do not have control any more; take it first".to_owned()),
        }
    });
    match preparing.await {
        Ok(Ok(())) => StatusCode::ACCEPTED.into_response(),
        Ok(Err(why)) => (StatusCode::CONFLICT, why).into_response(),
        Err(_) => refused(
            StatusCode::INTERNAL_SERVER_ERROR,
            "the file could not be taken; try again",
        ),
    }
}

/// A running upload, until it is dropped.
struct Uploading(Arc<AtomicBool>);

impl Drop for Uploading {
    fn drop(&mut self) {
        self.0.store(false, Ordering::Relaxed);
    }
}

/// The complete body of the announced length, if it arrives.
async fn content_of(body: Body, length: usize) -> Result<Vec<u8>, (StatusCode, &'static str)> {
    const TOO_LONG: (StatusCode, &str) = (StatusCode::PAYLOAD_TOO_LARGE, "the file is larger than 32 MB");
    const STUCK: (StatusCode, &str) = (StatusCode::REQUEST_TIMEOUT, "the file stopped coming");
    if length > FILE_BYTES_MAX {
        return Err(TOO_LONG);
    }
    let mut content = Vec::with_capacity(length);
    let mut parts = body.into_data_stream();
    while let Some(part) = tokio::time::timeout(PAUSE_MAX, parts.next()).await.map_err(|_| STUCK)? {
        let part = part.map_err(|_| STUCK)?;
        if content.len() + part.len() > FILE_BYTES_MAX {
            return Err(TOO_LONG);
        }
        content.extend_from_slice(&part);
    }
    Ok(content)
}

/// Decodes a name encoded by `encodeURIComponent`.
fn decoded(name: &str) -> String {
    let mut bytes = Vec::new();
    let mut rest = name.bytes();
    while let Some(byte) = rest.next() {
        let digit = |byte: Option<u8>| char::from(byte?).to_digit(16);
        match (byte, rest.clone().next(), rest.clone().nth(1)) {
            (b'%', high, low) if digit(high).is_some() && digit(low).is_some() => {
                let value = digit(high).unwrap_or(0) * 16 + digit(low).unwrap_or(0);
                bytes.push(value as u8);
                rest.nth(1);
            }
            _ => bytes.push(byte),
        }
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

/// Periodic work: ends control of vanished viewers and publishes the counters.
async fn look_after(console: Arc<Console>) {
    let mut looks = 0_u32;
    loop {
        tokio::time::sleep(LOOK).await;
        let now_ms = console.now_ms();
        let change = console.hub().control.tick(now_ms);
        match change {
            Some(Change::Vanished) => console.change(|hub| {
                hub.note(Level::Warning, "nothing is heard of the viewer with control");
            }),
            Some(Change::Released) => console.change(|hub| {
                hub.note(Level::Info, "control is free: its viewer did not come back");
                hub.say_control();
            }),
            None => {}
        }
        looks = looks.wrapping_add(1);
        if looks.is_multiple_of(LOOKS_PER_REPORT) {
            console.hub().say_link();
            console.say_segment();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_names_of_this_computer_are_served_on_loopback() {
        let address = "127.0.0.1:8123".parse().unwrap();
        for host in ["127.0.0.1:8123", "localhost:8123", "[::1]:8123"] {
            assert!(is_host(host, address), "{host}");
        }
        for host in [
            "",
            "127.0.0.1",
            "localhost:80",
            "evil.example:8123",
            "127.0.0.1.evil.example:8123",
        ] {
            assert!(!is_host(host, address), "{host}");
        }
        assert!(is_host("robot.local:8123", "0.0.0.0:8123".parse().unwrap()));
    }

    #[test]
    fn names_are_read_as_the_browser_writes_them() {
        assert_eq!(decoded("gr%C3%BCn%20%26.png"), "grün &.png");
        assert_eq!(decoded("50%"), "50%");
        assert_eq!(decoded("%zz%4"), "%zz%4");
    }
}
