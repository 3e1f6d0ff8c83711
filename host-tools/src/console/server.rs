//! The console's HTTP server: the page, a socket for every viewer, a way in for files and for a stop.
//!
//! Invariants: a request that another page makes this browser send is refused by its origin, one that was sent to another
//! name by its host; whoever commands has the token that was printed in the terminal.

use super::assets::{ASSETS, POLICY};
use super::control::Change;
use super::hub::Level;
use super::messages::{FILE_BYTES_MAX, REQUEST_BYTES_MAX};
use super::studio::Wishes;
use super::{Console, viewer};
use axum::Router;
use axum::body::{Body, Bytes};
use axum::extract::ws::WebSocketUpgrade;
use axum::extract::{DefaultBodyLimit, Request, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use std::io;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::thread::{self, JoinHandle};
use std::time::Duration;
use tokio::sync::oneshot;

/// Time between two looks at what nobody asks for.
const LOOK: Duration = Duration::from_millis(200);
/// Looks between two reports of the link's counts.
const LOOKS_PER_REPORT: u32 = 5;
/// Header of the token.
const TOKEN: &str = "x-etherpen-token";
/// Header of the number that the viewer was given.
const VIEWER: &str = "x-etherpen-viewer";
/// Header of a file's name.
const NAME: &str = "x-etherpen-name";
/// Header of what is wished of a drawing, as JSON.
const OPTIONS: &str = "x-etherpen-options";
/// Most bytes that wait for one viewer in this process.
const WRITE_BUFFER_MAX: usize = 64 << 20;

/// A running server; dropping it ends it.
pub struct Server {
    address: SocketAddr,
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Clone)]
struct Door {
    console: Arc<Console>,
    address: SocketAddr,
}

impl Server {
    /// Starts to serve at an address; port 0 takes a free one.
    ///
    /// # Errors
    /// The address cannot be used.
    pub fn start(console: Arc<Console>, address: SocketAddr) -> io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        let address = listener.local_addr()?;
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let (end, ended) = oneshot::channel::<()>();
        let thread = thread::Builder::new().name("console".to_owned()).spawn(move || {
            runtime.block_on(async move {
                tokio::spawn(look_after(console.clone()));
                let Ok(listener) = tokio::net::TcpListener::from_std(listener) else {
                    return;
                };
                let app = router(Door { console, address });
                tokio::select! {
                    _ = axum::serve(listener, app).into_future() => {}
                    _ = ended => {}
                }
            });
            runtime.shutdown_background();
        })?;
        Ok(Self {
            address,
            end: Some(end),
            thread: Some(thread),
        })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        if let Some(end) = self.end.take() {
            // A server that has ended already is what is wanted.
            let _ = end.send(());
        }
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
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
        .route("/stop", post(stop))
        .route("/file", post(file).layer(DefaultBodyLimit::max(FILE_BYTES_MAX)))
        .layer(middleware::from_fn_with_state(door.clone(), guard))
        .with_state(door)
}

/// Refuses what does not come from this page, and tells the browser what the page may do.
async fn guard(State(door): State<Door>, request: Request<Body>, next: Next) -> Response {
    let host = text(request.headers(), header::HOST.as_str());
    let origin = text(request.headers(), header::ORIGIN.as_str());
    let mut response = if !is_host(host, door.address) {
        refused(StatusCode::FORBIDDEN, "this console is not known by that name")
    } else if !origin.is_empty() && origin.strip_prefix("http://") != Some(host) {
        refused(StatusCode::FORBIDDEN, "another page may not talk to this console")
    } else {
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

/// Whether a request for this host is meant for a server at this address; a name that somebody let point here is not.
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
        .on_upgrade(move |socket| viewer::serve(socket, door.console))
}

fn has_token(door: &Door, headers: &HeaderMap) -> bool {
    viewer::same(text(headers, TOKEN).as_bytes(), door.console.token.as_bytes())
}

/// A second way for a stop, beside the socket.
async fn stop(State(door): State<Door>, headers: HeaderMap) -> Response {
    if !has_token(&door, &headers) {
        return refused(StatusCode::FORBIDDEN, "wrong token");
    }
    door.console.stop("a page");
    StatusCode::ACCEPTED.into_response()
}

async fn file(State(door): State<Door>, headers: HeaderMap, content: Bytes) -> Response {
    if !has_token(&door, &headers) {
        return refused(StatusCode::FORBIDDEN, "wrong token");
    }
    let viewer = text(&headers, VIEWER).parse().unwrap_or(0);
    if !door.console.hub().control.is_held_by(viewer) {
        return refused(StatusCode::CONFLICT, "you do not have control; take it first");
    }
    let name = decoded(text(&headers, NAME));
    let wishes = match Wishes::parse(&decoded(text(&headers, OPTIONS))) {
        Ok(wishes) => wishes,
        Err(why) => return (StatusCode::BAD_REQUEST, why).into_response(),
    };
    match door.console.prepare(&name, wishes, content.into()) {
        Ok(()) => StatusCode::ACCEPTED.into_response(),
        Err(why) => (StatusCode::CONFLICT, why).into_response(),
    }
}

/// A name as `encodeURIComponent` writes it.
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

/// What has to happen although nobody asks: control of the vanished ends, counts are told.
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
