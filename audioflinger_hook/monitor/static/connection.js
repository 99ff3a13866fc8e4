// The live connection: a websocket, opened again after each loss, whose first message shows a code or the key.

const RETRY_MS = 700;
const AWAY = "the page's server is away; start it with `cushion monitor`";

export class Connection {
  /** listen: called with (kind, content) for "link", "status", "figures", "settings", "frame" and "traffic". */
  constructor(listen) {
    Object.assign(this, { listen, waiting: new Map(), number: 0, socket: null, code: "", key: sessionStorage.getItem("key") ?? "" });
  }

  open() {
    if (!("WebSocket" in window)) {
      this.listen("link", { connected: false, text: "this browser has no websockets; use a newer one" });
      return;
    }
    this.takeCode();
    addEventListener("hashchange", () => this.takeCode());
    this.connect();
  }

  /** Take the code, which works once, out of the address. */
  takeCode() {
    if (!location.hash) return;
    this.code = location.hash.slice(1);
    history.replaceState(null, "", location.pathname);
  }

  connect() {
    const socket = new WebSocket(`ws://${location.host}/live`);
    socket.onopen = () => socket.send(JSON.stringify({ code: this.code, key: this.key }));
    socket.onmessage = (event) => this.take(JSON.parse(event.data), socket);
    socket.onclose = ({ reason }) => {
      this.socket = null;
      for (const settle of this.waiting.values()) settle({ error: "the connection is lost; try again" });
      this.waiting.clear();
      setTimeout(() => this.connect(), RETRY_MS);
      this.listen("link", { connected: false, text: reason || AWAY });
    };
  }

  take(message, socket) {
    if ("key" in message) {
      Object.assign(this, { socket, code: "", key: message.key });
      sessionStorage.setItem("key", message.key); // for a reload, and for a tab that this one opens
    } else if ("frame" in message) {
      socket.send(JSON.stringify({ ack: message.n }));
      this.listen("frame", message.frame);
      this.listen("traffic", { overwritten: message.overwritten, missed: message.frame.missed });
    } else if ("answer" in message) {
      this.waiting.get(message.id)?.(message.answer);
      this.waiting.delete(message.id);
    } else {
      for (const [kind, content] of Object.entries(message)) this.listen(kind, content);
    }
  }

  /** Ask the daemon for a change; resolves to {done: true} or {error, key}. */
  ask(request) {
    if (!this.socket) return Promise.resolve({ error: "there is no connection; wait until it is back" });
    const id = ++this.number;
    return new Promise((settle) => {
      this.waiting.set(id, settle);
      this.socket.send(JSON.stringify({ id, ...request }));
    });
  }
}
