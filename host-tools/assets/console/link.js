// The socket to the console: receives sections of its state, sends requests, and reconnects when it breaks.
//
// A requested stop stays pending until the firmware's own state confirms it; after a reconnection it is sent first.

const RETRY_MS = [200, 400, 800, 1500];
const ALIVE_MS = 700;

// Known before the modules are loaded: the token, and whether a stop was requested.
const stop = globalThis.etherpenStop;

function page() {
  let name = sessionStorage.getItem("page");
  if (!name) {
    name = Array.from(crypto.getRandomValues(new Uint8Array(8)), (byte) => byte.toString(16).padStart(2, "0")).join("");
    sessionStorage.setItem("page", name);
  }
  return name;
}

export class Link extends EventTarget {
  constructor() {
    super();
    this.page = page();
    this.state = {};
    this.bytes = 0;
    this.tries = 0;
    this.open = false;
    this.heard = { time_ms: null, at: performance.now() };
    stop.addEventListener("ask", () => this.send({ type: "stop" }));
    stop.addEventListener("change", () => this.tell("stopping"));
    setInterval(() => this.send({ type: "alive" }), ALIVE_MS);
    this.connect();
  }

  connect() {
    const socket = new WebSocket(`ws://${location.host}/socket`);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.onopen = () => {
      this.tries = 0;
      this.open = true;
      this.send({ type: "hello", token: stop.token, page: this.page });
      if (stop.asked) this.send({ type: "stop" });
      this.tell("open");
    };
    socket.onmessage = ({ data }) => this.take(data);
    socket.onclose = () => {
      this.open = false;
      this.state = {};
      this.tell("closed");
      const wait = RETRY_MS[Math.min(this.tries, RETRY_MS.length - 1)];
      this.tries += 1;
      setTimeout(() => this.connect(), wait);
    };
  }

  take(data) {
    if (typeof data !== "string") {
      this.bytes += data.byteLength;
      this.takeBinary(new DataView(data));
      return;
    }
    this.bytes += data.length;
    const { section, data: content } = JSON.parse(data);
    this.state[section] = content;
    // A robot stopped by another fault is stopped as well.
    if (section === "status" && content?.mode === "Fault") stop.stands();
    if (section === "pose" && content && content.time_ms !== this.heard.time_ms) this.heard = { time_ms: content.time_ms, at: performance.now() };
    this.tell(section, content);
  }

  takeBinary(view) {
    const kind = view.getUint8(0);
    if (kind === 1) {
      const signals = view.getUint16(2, true);
      const count = view.getUint32(12, true);
      const columns = {
        id: view.getUint32(4, true),
        reset: (view.getUint8(1) & 1) !== 0,
        last: (view.getUint8(1) & 2) !== 0,
        signals,
        bucketMs: view.getUint32(8, true),
        numbers: new Uint32Array(view.buffer, 16, count),
        spans: new Float32Array(view.buffer, 16 + 4 * count, count * signals * 2),
      };
      this.tell("columns", columns);
    } else if (kind === 2) {
      const count = view.getUint32(8, true);
      const path = { use: view.getUint8(1), number: view.getUint32(4, true), index: new Uint32Array(count), drawn: new Uint8Array(count), x: new Float32Array(count), y: new Float32Array(count) };
      for (let vertex = 0; vertex < count; vertex += 1) {
        const at = 12 + 12 * vertex;
        const word = view.getUint32(at, true);
        path.index[vertex] = word & 0x7fffffff;
        path.drawn[vertex] = word >>> 31;
        path.x[vertex] = view.getFloat32(at + 4, true);
        path.y[vertex] = view.getFloat32(at + 8, true);
      }
      this.tell("path", path);
    } else if (kind === 3) {
      const use = view.getUint8(1);
      const file = new Blob([new Uint8Array(view.buffer, 8)], { type: use === 1 ? "image/jpeg" : "image/png" });
      this.tell("picture", { use, number: view.getUint32(4, true), file });
    }
  }

  tell(name, detail) {
    this.dispatchEvent(new CustomEvent(name, { detail }));
  }

  on(name, listener) {
    this.addEventListener(name, (event) => listener(event.detail));
    if (this.state[name] !== undefined) listener(this.state[name]);
  }

  send(request) {
    if (this.socket.readyState !== WebSocket.OPEN) return false;
    this.socket.send(JSON.stringify(request));
    return true;
  }

  command(action) {
    return this.send({ type: "command", action });
  }

  // Seconds since the last new measurement.
  silentSeconds() {
    return (performance.now() - this.heard.at) / 1000;
  }

  upload(file, options) {
    const headers = {
      "x-etherpen-token": stop.token,
      "x-etherpen-viewer": String(this.state.you?.id ?? 0),
      "x-etherpen-name": encodeURIComponent(file.name),
      "x-etherpen-options": encodeURIComponent(options),
    };
    return fetch("/file", { method: "POST", headers, body: file });
  }

  get stopping() {
    return stop;
  }

  get controls() {
    return this.open && this.state.control?.holder !== null && this.state.control?.holder === this.state.you?.id;
  }

  allows(name) {
    return this.state.status?.allowed?.includes(name) ?? false;
  }
}
