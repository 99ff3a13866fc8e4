// The live connection: the token becomes a cookie, then a websocket that is opened again after each loss.

const RETRY_MS = 700;

/** Show the token of the address to the server, which answers with a cookie that scripts cannot read. */
async function openSession() {
  const token = location.hash.slice(1);
  if (!token) return;
  history.replaceState(null, "", location.pathname);
  await fetch("/session", { headers: { Authorization: `Bearer ${token}` }, cache: "no-store" });
}

/**
 * listen: called with (kind, content) for "link", "status", "settings", "frame" and "traffic".
 */
export class Connection {
  constructor(listen) {
    this.listen = listen;
    this.waiting = new Map();
    this.number = 0;
    this.socket = null;
  }

  async open() {
    if (!("WebSocket" in window)) {
      this.listen("link", { connected: false, text: "this browser has no websockets; use a newer one" });
      return;
    }
    try {
      await openSession();
    } catch {
      // The server is away; the websocket tells so as well.
    }
    this.connect();
  }

  connect() {
    const socket = new WebSocket(`ws://${location.host}/live`);
    socket.onopen = () => { this.socket = socket; };
    socket.onmessage = (event) => this.take(event.data, socket);
    socket.onclose = () => {
      this.socket = null;
      for (const settle of this.waiting.values()) settle({ error: "the connection is lost; try again" });
      this.waiting.clear();
      this.explain();
      setTimeout(() => this.connect(), RETRY_MS);
    };
  }

  /** Say why the websocket does not open: a browser tells its script nothing. */
  async explain() {
    const away = "the page's server is away; start it with `cushion monitor`";
    const closed = "open the whole address that `cushion monitor` prints: it ends with a key after #";
    let text = away;
    try {
      const answer = await fetch("/session", { cache: "no-store" });
      if (answer.status === 403) text = closed;
      if (answer.status === 503) text = (await answer.text()).trim();
      if (answer.ok) text = "the page's server answers again; connecting";
    } catch {
      // no server answers
    }
    if (!this.socket) this.listen("link", { connected: false, text });
  }

  take(text, socket) {
    let message;
    try {
      message = JSON.parse(text);
    } catch {
      return;
    }
    if ("frame" in message) {
      socket.send(JSON.stringify({ ack: message.n }));
      this.listen("frame", message.frame);
      this.listen("traffic", { overwritten: message.overwritten, missed: message.frame.missed });
    } else if ("answer" in message) {
      const settle = this.waiting.get(message.id);
      this.waiting.delete(message.id);
      if (settle) settle(message.answer);
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
