//! Any bytes as requests of a page, and as what a browser sends to the console's server.
//!
//! The console waits for a robot that never connects. Its server listens on a port of this computer, as it does for a
//! browser.

use etherpen::config::Config;
use host_tools::console::Console;
use host_tools::console::messages::{REQUEST_BYTES_MAX, Request};
use host_tools::console::preparation::{PageOptions, shown_name};
use host_tools::console::server::Server;
use host_tools::link::port::PortName;
use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::sync::OnceLock;
use std::time::Duration;

/// The token of the console.
const TOKEN: &str = "0123456789abcdef";
/// Words of an input that stand for the server's address and for the token.
const HOST: &[u8] = b"@HOST@";
const SECRET: &[u8] = b"@TOKEN@";
/// Longest wait for the server; a busy computer is slow, not wrong.
const PATIENCE: Duration = Duration::from_secs(60);
/// Most requests of an input.
const REQUESTS_MAX: usize = 16;

/// A server that runs until the process ends.
fn server() -> &'static Server {
    static SERVER: OnceLock<Server> = OnceLock::new();
    SERVER.get_or_init(|| {
        let nobody = PortName::Unix("/nonexistent/etherpen-fuzzing".into());
        let console = Console::start(Config::default(), TOKEN.to_owned(), nobody, None, None).expect("a console");
        Server::start(console, "127.0.0.1:0".parse().expect("an address")).expect("a server")
    })
}

/// Sends bytes to the server, then the end; returns the answer, at most so many bytes of it.
fn exchange(bytes: &[u8]) -> Vec<u8> {
    let mut stream = TcpStream::connect(server().address()).expect("the server accepts");
    stream.set_read_timeout(Some(PATIENCE)).expect("a time limit");
    // The server may end the connection before it has read everything.
    let _ = stream.write_all(bytes);
    let _ = stream.shutdown(Shutdown::Write);
    let mut answer = Vec::new();
    match stream.read_to_end(&mut answer) {
        Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
            panic!("no end of the answer within {PATIENCE:?}")
        }
        // A reset connection is an end as well.
        _ => answer,
    }
}

/// Reads each line as a request and as the options of a drawing, then sends them through a WebSocket.
pub(crate) fn messages(bytes: &[u8]) {
    let lines: Vec<&[u8]> = bytes.split(|byte| *byte == b'\n').take(REQUESTS_MAX).collect();
    let mut understood = 0;
    for line in &lines {
        let Ok(text) = std::str::from_utf8(line) else { continue };
        match serde_json::from_str::<Request>(text) {
            Ok(_) => understood += 1,
            Err(error) => assert!(!error.to_string().is_empty()),
        }
        if let Err(error) = PageOptions::parse(text).and_then(|options| options.explicit()) {
            assert!(!error.is_empty());
        }
        assert!(!shown_name(text).is_empty());
    }
    if understood > 0 {
        let answer = socket(&lines);
        assert!(
            answer.starts_with(b"HTTP/1.1 101 "),
            "{}",
            String::from_utf8_lossy(&answer)
        );
    }
}

/// One text frame of a WebSocket, with a mask of zeros.
fn text_frame(text: &[u8]) -> Vec<u8> {
    let text = text.get(..REQUEST_BYTES_MAX).unwrap_or(text);
    let mut frame = vec![0x81];
    match u8::try_from(text.len()) {
        Ok(length) if length < 126 => frame.push(0x80 | length),
        _ => {
            frame.push(0x80 | 126);
            frame.extend((text.len() as u16).to_be_bytes());
        }
    }
    frame.extend([0; 4]);
    frame.extend(text);
    frame
}

/// Sends requests behind a greeting with the token, then a closing frame.
fn socket(lines: &[&[u8]]) -> Vec<u8> {
    let address = server().address();
    let mut bytes = format!(
        "GET /socket HTTP/1.1\r\nHost: {address}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
         Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
    )
    .into_bytes();
    let greeting = format!("{{\"type\":\"hello\",\"token\":\"{TOKEN}\",\"page\":\"fuzzing\"}}");
    bytes.extend(text_frame(greeting.as_bytes()));
    bytes.extend(text_frame(b"{\"type\":\"take\",\"force\":true}"));
    for line in lines {
        bytes.extend(text_frame(line));
    }
    bytes.extend([0x88, 0x80, 0, 0, 0, 0]);
    exchange(&bytes)
}

/// Every request of the page.
pub(crate) fn message_seeds() -> Vec<Vec<u8>> {
    let requests = [
        r#"{"type":"alive"}"#,
        r#"{"type":"stop"}"#,
        r#"{"type":"release"}"#,
        r#"{"type":"command","action":{"do":"enable"}}"#,
        r#"{"type":"command","action":{"do":"override","percent":80}}"#,
        r#"{"type":"command","action":{"do":"move","position_mm":[0.1,2,-850.5]}}"#,
        r#"{"type":"command","action":{"do":"pen","down":true}}"#,
        r#"{"type":"jog","velocity_mm_s":[20,0,-5]}"#,
        r#"{"type":"jog_axis","axis":2,"forward":false,"press":1}"#,
        r#"{"type":"saw","axis":2,"seen":{"other":1}}"#,
        r#"{"type":"touch","action":"add"}"#,
        r#"{"type":"continue","job":1}"#,
        r#"{"type":"pen_is_in","job":1}"#,
        r#"{"type":"watch","id":1,"signals":[0,1],"window_ms":1000,"columns":100}"#,
        r#"{"type":"freeze"}"#,
        r#"{"type":"range","id":2,"signals":[3],"from_ms":0,"to_ms":60000,"columns":0}"#,
        r#"{"type":"thaw"}"#,
        r#"{"type":"arm","signal":1,"condition":"above","level":0.25,"before_ms":1,"after_ms":2}"#,
        r#"{"type":"disarm"}"#,
        r#"{"type":"inject","fault":{"what":"remove","slave":2}}"#,
        r#"{"type":"replan","wishes":{"style":"","size":"100mm","max_time":"60s"}}"#,
        r#"{"type":"replan","wishes":{"crop":"10,20,300,400","background":"none","focus":"90,80,30"}}"#,
        r#"{"crop":"head","background":"keep","focus":"1e308,5,5"}"#,
        r#"{"type":"vary"}"#,
        r#"{"type":"enqueue","preparation":1}"#,
        r#"{"type":"start","job":1}"#,
        r#"{"type":"discard","job":1}"#,
        r#"{"type":"measure","reset":true}"#,
        r#"{"style":"contour","size":"9cm","max_time":"3min"}"#,
    ];
    let mut seeds: Vec<Vec<u8>> = requests.iter().map(|text| text.as_bytes().to_vec()).collect();
    seeds.push(requests[..12].join("\n").into_bytes());
    seeds
}

/// Sends any bytes to the server. Without the token nothing is accepted.
pub(crate) fn http(bytes: &[u8]) {
    let knows = contains(bytes, SECRET) || contains(bytes, TOKEN.as_bytes());
    let address = server().address().to_string();
    let bytes = replaced(&replaced(bytes, HOST, address.as_bytes()), SECRET, TOKEN.as_bytes());
    let answer = exchange(&bytes);
    assert!(
        answer.is_empty() || answer.starts_with(b"HTTP/1."),
        "{}",
        String::from_utf8_lossy(&answer)
    );
    assert!(
        knows || !contains(&answer, b" 202 Accepted\r\n"),
        "accepted without the token"
    );
    assert!(
        !contains(&answer, b" 500 Internal"),
        "{}",
        String::from_utf8_lossy(&answer)
    );
}

fn contains(bytes: &[u8], word: &[u8]) -> bool {
    bytes.windows(word.len()).any(|part| part == word)
}

/// Replaces every occurrence of a word.
fn replaced(bytes: &[u8], word: &[u8], by: &[u8]) -> Vec<u8> {
    let mut result = Vec::with_capacity(bytes.len());
    let mut rest = bytes;
    while let Some((first, behind)) = rest.split_first() {
        match rest.strip_prefix(word) {
            Some(behind) => {
                result.extend(by);
                rest = behind;
            }
            None => {
                result.push(*first);
                rest = behind;
            }
        }
    }
    result
}

/// Requests of a browser, and refused ones.
pub(crate) fn http_seeds() -> Vec<Vec<u8>> {
    let requests = [
        "GET / HTTP/1.1\r\nHost: @HOST@\r\nConnection: close\r\n\r\n",
        "GET /robot.js HTTP/1.1\r\nHost: evil.example\r\n\r\n",
        "POST /stop HTTP/1.1\r\nHost: @HOST@\r\nx-etherpen-token: @TOKEN@\r\nContent-Length: 0\r\n\r\n",
        "POST /stop HTTP/1.1\r\nHost: @HOST@\r\nOrigin: http://evil.example\r\nx-etherpen-token: @TOKEN@\r\n\r\n",
        "POST /file HTTP/1.1\r\nHost: @HOST@\r\nx-etherpen-token: @TOKEN@\r\nx-etherpen-viewer: 1\r\n\
         x-etherpen-name: gr%C3%BCn.svg\r\nx-etherpen-options: %7B%7D\r\nContent-Length: 4\r\n\r\nG0 X",
        "POST /file HTTP/1.1\r\nHost: @HOST@\r\nx-etherpen-token: @TOKEN@\r\nTransfer-Encoding: chunked\r\n\r\n4\r\nG0 X\r\n0\r\n\r\n",
        "GET /socket HTTP/1.1\r\nHost: @HOST@\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
         Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n\u{8}\0",
        "GET / HTTP/1.0\r\n\r\n",
    ];
    requests.iter().map(|text| text.as_bytes().to_vec()).collect()
}
