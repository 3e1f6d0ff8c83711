//! A headless Chromium, controlled over its DevTools protocol.

use super::client::PATIENCE;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};
use tungstenite::{Message, WebSocket};

const PROGRAM: &str = "chromium";
/// Time between two checks of a condition.
const LOOK: Duration = Duration::from_millis(50);
static BROWSERS: AtomicU32 = AtomicU32::new(0);

/// A browser with one page.
pub(crate) struct Browser {
    child: Child,
    profile: PathBuf,
    socket: WebSocket<TcpStream>,
    session: String,
    next: u64,
    /// Errors of scripts, and every address requested.
    pub(crate) errors: Vec<String>,
    pub(crate) requests: Vec<String>,
}

impl Browser {
    /// Starts a browser; `None`, with a message, if there is none and none can be installed.
    pub(crate) fn start() -> Option<Self> {
        if let Err(missing) = host_tools::setup::ensure_program(PROGRAM) {
            println!("SKIPPED: no browser. {missing}");
            return None;
        }
        let number = BROWSERS.fetch_add(1, Ordering::Relaxed);
        let profile = std::env::temp_dir().join(format!("etherpen-chromium-{}-{number}", std::process::id()));
        let mut child = Command::new(PROGRAM)
            .args([
                "--headless",
                "--no-sandbox",
                "--disable-gpu",
                "--disable-dev-shm-usage",
                "--no-first-run",
            ])
            .args([
                "--disable-background-networking",
                "--disable-component-update",
                "--remote-debugging-port=0",
            ])
            .arg(format!("--user-data-dir={}", profile.display()))
            .arg("about:blank")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("chromium starts");
        let mut lines = BufReader::new(child.stderr.take().expect("its messages")).lines();
        let address = lines
            .by_ref()
            .map_while(Result::ok)
            .find_map(|line| {
                line.split_once("listening on ws://")
                    .map(|(_, address)| address.to_owned())
            })
            .expect("chromium says where it listens");
        // Its messages are read so that it never blocks.
        std::thread::spawn(move || lines.for_each(drop));
        let (host, _) = address.split_once('/').expect("an address");
        let stream = TcpStream::connect(host).expect("chromium listens");
        stream.set_read_timeout(Some(PATIENCE)).expect("a time limit");
        let (socket, _) = tungstenite::client(format!("ws://{address}"), stream).expect("chromium answers");
        let mut browser = Self {
            child,
            profile,
            socket,
            session: String::new(),
            next: 0,
            errors: Vec::new(),
            requests: Vec::new(),
        };
        let target = browser.call("Target.createTarget", json!({"url": "about:blank"}));
        let attach = json!({"targetId": target["targetId"], "flatten": true});
        let attached = browser.call("Target.attachToTarget", attach);
        browser.session = attached["sessionId"].as_str().expect("a session").to_owned();
        for domain in ["Page.enable", "Runtime.enable", "Network.enable", "Log.enable"] {
            browser.call(domain, json!({}));
        }
        Some(browser)
    }

    /// Calls a method of the protocol and waits for its answer.
    pub(crate) fn call(&mut self, method: &str, params: Value) -> Value {
        self.try_call(method, params)
            .unwrap_or_else(|error| panic!("{method}: {error}"))
    }

    fn try_call(&mut self, method: &str, params: Value) -> Result<Value, Value> {
        self.next += 1;
        let mut message = json!({"id": self.next, "method": method, "params": params});
        if !self.session.is_empty() {
            message["sessionId"] = json!(self.session);
        }
        self.socket
            .send(Message::text(message.to_string()))
            .expect("chromium listens");
        loop {
            let Message::Text(text) = self.socket.read().expect("chromium answers") else {
                continue;
            };
            let mut answer: Value = serde_json::from_str(&text).expect("JSON");
            if answer["id"] == self.next {
                return match answer["error"].take() {
                    Value::Null => Ok(answer["result"].take()),
                    error => Err(error),
                };
            }
            self.note(&answer);
        }
    }

    fn note(&mut self, event: &Value) {
        let params = &event["params"];
        match event["method"].as_str() {
            Some("Runtime.exceptionThrown") => self.errors.push(params["exceptionDetails"].to_string()),
            Some("Log.entryAdded") if params["entry"]["level"] == "error" => {
                self.errors.push(params["entry"].to_string());
            }
            Some("Network.requestWillBeSent") => {
                let url = params["request"]["url"].as_str().unwrap_or_default();
                self.requests.push(url.to_owned());
            }
            Some("Network.webSocketCreated") => {
                self.requests
                    .push(params["url"].as_str().unwrap_or_default().to_owned());
            }
            _ => {}
        }
    }

    /// Sets the size of the page's window; a small one is a phone.
    pub(crate) fn window(&mut self, width: u32, height: u32) {
        let mobile = width < 600;
        let scale = if mobile { 2 } else { 1 };
        let metrics = json!({"width": width, "height": height, "deviceScaleFactor": scale, "mobile": mobile});
        self.call("Emulation.setDeviceMetricsOverride", metrics);
    }

    pub(crate) fn dark(&mut self, dark: bool) {
        let value = if dark { "dark" } else { "light" };
        let features = json!({"features": [{"name": "prefers-color-scheme", "value": value}]});
        self.call("Emulation.setEmulatedMedia", features);
    }

    pub(crate) fn open(&mut self, url: &str) {
        self.call("Page.navigate", json!({ "url": url }));
    }

    /// Value of an expression in the page; promises are awaited.
    pub(crate) fn value(&mut self, expression: &str) -> Value {
        self.try_value(expression)
            .unwrap_or_else(|failure| panic!("{expression}: {failure}"))
    }

    fn try_value(&mut self, expression: &str) -> Result<Value, Value> {
        let params = json!({"expression": expression, "awaitPromise": true, "returnByValue": true});
        let mut answer = self.try_call("Runtime.evaluate", params)?;
        match answer["exceptionDetails"].take() {
            Value::Null => Ok(answer["result"]["value"].take()),
            failure => Err(failure),
        }
    }

    /// Waits until an expression in the page is true; a page that is still loading is retried.
    pub(crate) fn until(&mut self, expression: &str) {
        let begun = Instant::now();
        while self.try_value(&format!("Boolean({expression})")) != Ok(json!(true)) {
            if begun.elapsed() > PATIENCE {
                let text = self.value("document.body.innerText");
                panic!("waited for {expression}; the page says: {text}");
            }
            std::thread::sleep(LOOK);
        }
    }

    /// Presses a button as soon as it is enabled.
    pub(crate) fn press(&mut self, selector: &str) {
        let button = format!("document.querySelector({})", json!(selector));
        self.until(&format!("{button} && !{button}.disabled"));
        self.value(&format!("{button}.click()"));
    }

    /// Centre of an element in the window; the element is scrolled into view first.
    pub(crate) fn place(&mut self, selector: &str) -> [f64; 2] {
        let middle = self.value(&format!(
            "(() => {{ const it = document.querySelector({}); \
             const middle = () => {{ const box = it.getBoundingClientRect(); return [box.left + box.width / 2, box.top + box.height / 2]; }}; \
             if (it.id === 'stop' || it.contains(document.elementFromPoint(...middle()))) return middle(); \
             it.scrollIntoView({{ block: 'center', behavior: 'instant' }}); \
             return new Promise((told) => requestAnimationFrame(() => requestAnimationFrame(() => told(middle())))); }})()",
            json!(selector)
        ));
        [0, 1].map(|axis| middle[axis].as_f64().expect("a place"))
    }

    /// Presses or releases the mouse button.
    pub(crate) fn mouse(&mut self, down: bool, [x, y]: [f64; 2]) {
        let kind = if down { "mousePressed" } else { "mouseReleased" };
        let params =
            json!({"type": kind, "x": x, "y": y, "button": "left", "buttons": u8::from(down), "clickCount": 1});
        self.call("Input.dispatchMouseEvent", params);
    }

    /// Clicks with the mouse at an element's position, whatever covers it.
    pub(crate) fn click(&mut self, selector: &str) {
        let place = self.place(selector);
        self.mouse(true, place);
        self.mouse(false, place);
    }

    /// Touches the screen at an element's position.
    pub(crate) fn touch(&mut self, selector: &str) {
        let [x, y] = self.place(selector);
        self.call(
            "Input.dispatchTouchEvent",
            json!({"type": "touchStart", "touchPoints": [{"x": x, "y": y}]}),
        );
        self.call(
            "Input.dispatchTouchEvent",
            json!({"type": "touchEnd", "touchPoints": []}),
        );
    }

    /// Drags from one place of the window to another, with a finger or with the mouse.
    pub(crate) fn drag(&mut self, by_finger: bool, from: [f64; 2], to: [f64; 2]) {
        const STEPS: u32 = 8;
        let at = |step: u32| [0, 1].map(|k| from[k] + (to[k] - from[k]) * f64::from(step) / f64::from(STEPS));
        for step in 0..=STEPS {
            let [x, y] = at(step);
            if by_finger {
                let kind = if step == 0 { "touchStart" } else { "touchMove" };
                let params = json!({"type": kind, "touchPoints": [{"x": x, "y": y}]});
                self.call("Input.dispatchTouchEvent", params);
            } else if step == 0 {
                self.mouse(true, from);
            } else {
                let params = json!({"type": "mouseMoved", "x": x, "y": y, "button": "left", "buttons": 1});
                self.call("Input.dispatchMouseEvent", params);
            }
        }
        if by_finger {
            let params = json!({"type": "touchEnd", "touchPoints": []});
            self.call("Input.dispatchTouchEvent", params);
        } else {
            self.mouse(false, to);
        }
    }

    /// Presses and releases a key, wherever the focus is.
    pub(crate) fn key(&mut self, key: &str, code: u32) {
        self.key_with(0, key, code);
    }

    /// Presses and releases a key while Shift is held.
    pub(crate) fn shift_key(&mut self, key: &str, code: u32) {
        self.key_with(8, key, code);
    }

    fn key_with(&mut self, modifiers: u32, key: &str, code: u32) {
        for kind in ["rawKeyDown", "keyUp"] {
            let params =
                json!({"type": kind, "modifiers": modifiers, "key": key, "code": key, "windowsVirtualKeyCode": code});
            self.call("Input.dispatchKeyEvent", params);
        }
    }

    /// A picture of the window, or of the whole page.
    pub(crate) fn screenshot(&mut self, path: &Path, width: u32, height: Option<u32>) {
        self.window(width, height.unwrap_or(1_000));
        let whole = self
            .value("document.documentElement.scrollHeight")
            .as_u64()
            .unwrap_or(1_000) as u32;
        self.window(width, height.unwrap_or(whole));
        std::thread::sleep(Duration::from_millis(700));
        self.until("!document.querySelector('.toast')");
        self.capture(path);
    }

    /// Saves a picture of the window if `ETHERPEN_SCREENSHOTS` names a folder.
    pub(crate) fn keep(&mut self, name: &str) {
        if let Some(folder) = std::env::var_os("ETHERPEN_SCREENSHOTS") {
            let plain = name.replace(|letter: char| !letter.is_ascii_alphanumeric(), "-");
            std::fs::create_dir_all(&folder).expect("the folder is made");
            self.capture(&Path::new(&folder).join(format!("{plain}.png")));
        }
    }

    fn capture(&mut self, path: &Path) {
        let shot = self.call("Page.captureScreenshot", json!({"format": "png"}));
        let bytes = base64(shot["data"].as_str().expect("a picture"));
        std::fs::write(path, bytes).expect("the picture is written");
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // A browser that has already ended needs no kill.
        let _ = self.child.kill();
        let _ = self.child.wait();
        let _ = std::fs::remove_dir_all(&self.profile);
    }
}

fn base64(text: &str) -> Vec<u8> {
    let value = |character: u8| match character {
        b'A'..=b'Z' => Some(u32::from(character - b'A')),
        b'a'..=b'z' => Some(u32::from(character - b'a') + 26),
        b'0'..=b'9' => Some(u32::from(character - b'0') + 52),
        b'+' => Some(62),
        b'/' => Some(63),
        _ => None,
    };
    let digits: Vec<u32> = text.bytes().filter_map(value).collect();
    let mut bytes = Vec::with_capacity(digits.len() * 3 / 4);
    for group in digits.chunks(4) {
        let word = (0..4).fold(0, |word, index| word << 6 | group.get(index).copied().unwrap_or(0));
        bytes.extend(word.to_be_bytes().iter().skip(1).take(group.len() - 1));
    }
    bytes
}

#[test]
fn base64_is_read_as_it_is_written() {
    assert_eq!(base64("aGVsbG8="), b"hello");
    assert_eq!(base64("aGVsbG8h"), b"hello!");
}
