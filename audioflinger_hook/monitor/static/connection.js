// The live connection: the token becomes a cookie, then a websocket that is opened again after each loss.

const RETRY_MS = 700;
const AWAY = "the page's server is away; start it with `cushion monitor`";
const CLOSED = "open the whole address that `cushion monitor` prints: it ends with a key after #";

/** Show the token of the address to the server, which answers with a cookie that scripts cannot read. */
async function openSession() {
  const token = location.hash.slice(1);
  if (!token) return;
  history.replaceState(null, "", location.pathname);
  await fetch("/session", { headers: { Authorization: `Bearer ${token}` }, cache: "no-store" });
}

/** Why the websocket does not open: a browser tells its script nothing. */
async function reason() {
  const answer = await fetch("/session", { cache: "no-store" });
  if (answer.ok) return "the page's server answers again; connecting";
  return answer.status === 403 ? CLOSED : answer.status === 503 ? (await answer.text()).trim() : AWAY;
}

export class Connection {
  /** listen: called with (kind, content) for "link", "status", "figures", "settings", "frame" and "traffic". */
  constructor(listen) {
    Object.assign(this, { listen, waiting: new Map(), number: 0, socket: null });
  }

  async open() {
    if (!("WebSocket" in window)) {
      this.listen("link", { connected: false, text: "this browser has no websockets; use a newer one" });
      return;
    }
    await openSession().catch(() => {}); // the server is away; the websocket tells so as well
    this.connect();
  }

  connect() {
    const socket = new WebSocket(`ws://${location.host}/live`);
    socket.onopen = () => { this.socket = socket; };
    socket.onmessage = (event) => this.take(JSON.parse(event.data), socket);
    socket.onclose = async () => {
      this.socket = null;
      for (const settle of this.waiting.values()) settle({ error: "the connection is lost; try again" });
      this.waiting.clear();
      setTimeout(() => this.connect(), RETRY_MS);
      const text = await reason().catch(() => AWAY);
      if (!this.socket) this.listen("link", { connected: false, text });
    };
  }

  take(message, socket) {
    if ("frame" in message) {
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
