//! A real Chromium, without a window, driven through its DevTools protocol.

use std::io::{BufRead, BufReader};
use std::net::TcpStream;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use base64::Engine;
use serde_json::{Value, json};
use tempfile::TempDir;
use tungstenite::{Message, WebSocket, client};

/// How long anything may take, on a machine that draws without a GPU.
const PATIENCE: Duration = Duration::from_secs(90);

/// A page in a browser.
pub(crate) struct Browser {
    process: Child,
    _profile: TempDir,
    socket: WebSocket<TcpStream>,
    session: String,
    calls: u64,
    /// What the page told its console as an error, and errors that nobody caught.
    pub(crate) errors: Vec<String>,
    /// Everything that the page asked for over the network.
    pub(crate) requests: Vec<String>,
}

/// A picture of the page: red, green, blue, row by row.
pub(crate) struct Shot {
    pub(crate) pixels: Vec<[u8; 3]>,
}

/// Chromium, if there is one. Without one, tests say so and pass, unless TSDFUSE_REQUIRE_CHROMIUM is set.
pub(crate) fn chromium() -> Option<PathBuf> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let named = std::env::var_os("TSDFUSE_CHROMIUM").map(PathBuf::from);
    let names = ["chromium", "chromium-browser", "google-chrome"];
    let found = std::env::split_paths(&path).flat_map(|folder| names.map(|name| folder.join(name)));
    let found = named.into_iter().chain(found).find(|file| file.is_file());
    if found.is_none() {
        assert!(
            std::env::var_os("TSDFUSE_REQUIRE_CHROMIUM").is_none(),
            "TSDFUSE_REQUIRE_CHROMIUM is set, but there is no Chromium"
        );
        eprintln!("skipped: there is no Chromium (chromium, chromium-browser, google-chrome; or set TSDFUSE_CHROMIUM)");
    }
    found
}

impl Browser {
    /// Opens a page, of so many pixels.
    pub(crate) fn open(chromium: &PathBuf, url: &str, [width, height]: [usize; 2]) -> Self {
        let profile = tempfile::tempdir().unwrap();
        let mut process = Command::new(chromium)
            .args([
                "--headless=new",
                "--no-sandbox",
                "--no-first-run",
                "--remote-debugging-port=0",
                "--hide-scrollbars",
            ])
            .args([
                "--use-gl=angle",
                "--use-angle=swiftshader",
                "--enable-unsafe-swiftshader",
                "--force-device-scale-factor=1",
            ])
            .arg(format!("--window-size={width},{height}"))
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .arg("about:blank")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut told = BufReader::new(process.stderr.take().unwrap()).lines();
        let address = told
            .by_ref()
            .find_map(|line| Some(line.ok()?.strip_prefix("DevTools listening on ")?.to_owned()));
        let address = address.unwrap();
        std::thread::spawn(move || told.for_each(drop));
        let host = address
            .trim_start_matches("ws://")
            .split('/')
            .next()
            .unwrap()
            .to_owned();
        let stream = TcpStream::connect(host).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let (socket, _) = client(&address, stream).unwrap();
        let mut browser = Self {
            process,
            _profile: profile,
            socket,
            session: String::new(),
            calls: 0,
            errors: Vec::new(),
            requests: Vec::new(),
        };
        let target = browser.call("Target.createTarget", &json!({ "url": "about:blank" }));
        let session = browser.call(
            "Target.attachToTarget",
            &json!({ "targetId": target["targetId"], "flatten": true }),
        );
        browser.session = session["sessionId"].as_str().unwrap().to_owned();
        for domain in ["Page", "Runtime", "Log", "Network"] {
            browser.call(&format!("{domain}.enable"), &json!({}));
        }
        let metrics = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": false });
        browser.call("Emulation.setDeviceMetricsOverride", &metrics);
        browser.call("Page.navigate", &json!({ "url": url }));
        browser.wait("typeof tsdfuse !== 'undefined' && !!tsdfuse.ready");
        browser.eval("tsdfuse.ready.then(() => true)");
        browser
    }

    /// Calls a method of the protocol, and notes what happens meanwhile.
    pub(crate) fn call(&mut self, method: &str, parameters: &Value) -> Value {
        self.calls += 1;
        let mut call = json!({ "id": self.calls, "method": method, "params": parameters });
        if !self.session.is_empty() {
            call["sessionId"] = json!(self.session);
        }
        self.socket.send(Message::text(call.to_string())).unwrap();
        loop {
            let Message::Text(text) = self.socket.read().unwrap() else {
                continue;
            };
            let told: Value = serde_json::from_str(&text).unwrap();
            if told["id"] == self.calls {
                assert!(told["error"].is_null(), "{method}: {}", told["error"]);
                return told["result"].clone();
            }
            self.note(&told);
        }
    }

    fn note(&mut self, told: &Value) {
        let parameters = &told["params"];
        match told["method"].as_str() {
            Some("Runtime.exceptionThrown") => self.errors.push(parameters["exceptionDetails"].to_string()),
            Some("Runtime.consoleAPICalled") if parameters["type"] == "error" => {
                self.errors.push(parameters["args"].to_string());
            }
            Some("Log.entryAdded") if parameters["entry"]["level"] == "error" => {
                self.errors.push(parameters["entry"].to_string());
            }
            Some("Network.requestWillBeSent") => {
                self.requests
                    .push(parameters["request"]["url"].as_str().unwrap().to_owned());
            }
            Some("Network.webSocketCreated") => self.requests.push(parameters["url"].as_str().unwrap().to_owned()),
            _ => {}
        }
    }

    /// The value of an expression, waited for if it is a promise.
    pub(crate) fn eval(&mut self, expression: &str) -> Value {
        let parameters = json!({ "expression": expression, "awaitPromise": true, "returnByValue": true });
        let result = self.call("Runtime.evaluate", &parameters);
        assert!(
            result["exceptionDetails"].is_null(),
            "{expression}: {}",
            result["exceptionDetails"]
        );
        result["result"]["value"].clone()
    }

    /// What the page tells about itself.
    pub(crate) fn state(&mut self) -> Value {
        self.eval("tsdfuse.state()")
    }

    /// Waits until an expression is true.
    pub(crate) fn wait(&mut self, expression: &str) {
        let start = Instant::now();
        while self.eval(expression) != true {
            let what = format!("{expression}; errors: {:?}", self.errors);
            assert!(start.elapsed() < PATIENCE, "{what}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// What is seen once all is drawn.
    pub(crate) fn shot(&mut self) -> Shot {
        self.eval("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(true))))");
        let png = self.call("Page.captureScreenshot", &json!({ "format": "png" }));
        let png = base64::engine::general_purpose::STANDARD
            .decode(png["data"].as_str().unwrap())
            .unwrap();
        if let Some(folder) = std::env::var_os("TSDFUSE_KEEP_SHOTS") {
            let name = std::thread::current().name().unwrap_or("shot").replace("::", "-");
            std::fs::write(PathBuf::from(folder).join(format!("{name}-{}.png", self.calls)), &png).unwrap();
        }
        let mut reader = png::Decoder::new(std::io::Cursor::new(png)).read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut bytes).unwrap();
        let pixels = bytes[..info.buffer_size()].chunks_exact(info.color_type.samples());
        Shot {
            pixels: pixels.map(|pixel| [pixel[0], pixel[1], pixel[2]]).collect(),
        }
    }

    /// Presses a key.
    pub(crate) fn key(&mut self, code: &str) {
        self.hold(code, "true");
    }

    /// Presses a key until an expression is true.
    pub(crate) fn hold(&mut self, code: &str, until: &str) {
        self.call(
            "Input.dispatchKeyEvent",
            &json!({ "type": "rawKeyDown", "code": code, "key": code }),
        );
        self.wait(until);
        self.call(
            "Input.dispatchKeyEvent",
            &json!({ "type": "keyUp", "code": code, "key": code }),
        );
    }

    pub(crate) fn click(&mut self, [x, y]: [usize; 2]) {
        for kind in ["mousePressed", "mouseReleased"] {
            let event = json!({ "type": kind, "x": x, "y": y, "button": "left", "buttons": 1, "clickCount": 1 });
            self.call("Input.dispatchMouseEvent", &event);
        }
    }

    /// Drags fingers from their first to their second places.
    pub(crate) fn touch(&mut self, fingers: &[[[usize; 2]; 2]]) {
        let points = |share: f64| -> Vec<Value> {
            let at = |[from, to]: &[[usize; 2]; 2], axis: usize| {
                from[axis] as f64 + share * (to[axis] as f64 - from[axis] as f64)
            };
            let point = |(id, finger)| json!({ "x": at(finger, 0), "y": at(finger, 1), "id": id });
            fingers.iter().enumerate().map(point).collect()
        };
        self.call(
            "Input.dispatchTouchEvent",
            &json!({ "type": "touchStart", "touchPoints": points(0.0) }),
        );
        for step in 1..=5 {
            let points = points(f64::from(step) / 5.0);
            self.call(
                "Input.dispatchTouchEvent",
                &json!({ "type": "touchMove", "touchPoints": points }),
            );
        }
        self.call(
            "Input.dispatchTouchEvent",
            &json!({ "type": "touchEnd", "touchPoints": [] }),
        );
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
