// One WebSocket to the console, opened again by itself; what comes is given out by its kind. It knows how old the last
// word is: what is not live must not look it.

const LOST_MS = 1500; // nothing heard from the console for so long: it is lost
const AGAIN_MS = [250, 500, 1000, 2000, 3000];
const DECODER = new TextDecoder();
export const KIND = { status: 1, picture: 2, points: 3, wall: 4, rows: 5, slits: 6 };

export class Connection {
  constructor() {
    this.heardMs = 0;
    this.daemon = false;
    this.ageS = null;
    this.token = "";
    this.wants = [];
    this.onMessage = () => {};
    this.onChange = () => {};
    this.attempts = 0;
    this.socket = null;
    this.last = "";
    this.over = false;
    setInterval(() => this.look(), 200);
    document.addEventListener("visibilitychange", () => this.tell({ hidden: document.hidden }));
  }

  open() {
    this.over = false;
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/ws`);
    this.socket = socket;
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.tell({ want: this.wants });
      if (document.hidden) this.tell({ hidden: true });
    };
    socket.onmessage = (message) => this.hear(message.data);
    socket.onclose = () => {
      if (this.socket !== socket || this.over) return;
      this.socket = null;
      const wait = AGAIN_MS[Math.min(this.attempts++, AGAIN_MS.length - 1)];
      setTimeout(() => this.over || this.open(), wait);
    };
  }

  close() {
    this.over = true;
    this.socket?.close();
    this.socket = null;
  }

  hear(data) {
    if (!(data instanceof ArrayBuffer) || data.byteLength === 0) return;
    this.heardMs = performance.now();
    this.attempts = 0;
    const kind = new Uint8Array(data, 0, 1)[0];
    if (kind !== KIND.status) {
      this.onMessage(kind, data);
      return;
    }
    let told;
    try {
      told = JSON.parse(DECODER.decode(new Uint8Array(data, 1)));
    } catch {
      return;
    }
    if (told.topic === "alive") {
      this.daemon = told.body.daemon === true;
      this.ageS = told.body.age_s;
      this.tell({ here: true });
    }
    this.onMessage(kind, told);
    this.look();
  }

  // "live", "daemon" (the console is there, the daemon is not), "console".
  get state() {
    if (performance.now() - this.heardMs > LOST_MS || this.heardMs === 0) return "console";
    return this.daemon ? "live" : "daemon";
  }

  look() {
    const now = this.state;
    if (now !== this.last) {
      this.last = now;
      this.onChange(now);
    }
  }

  want(wants) {
    this.wants = wants;
    this.tell({ want: wants });
  }

  tell(said) {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(said));
  }

  async get(path) {
    return answered(await reached(fetch(path, { credentials: "same-origin" })));
  }

  async post(path, body = {}) {
    return answered(
      await reached(
        fetch(path, {
          method: "POST",
          credentials: "same-origin",
          headers: { "Content-Type": "application/json", "X-Annulus-Token": this.token },
          body: JSON.stringify(body),
        }),
      ),
    );
  }
}

export class Refused extends Error {
  constructor(line, status) {
    super(line);
    this.status = status;
  }
}

async function reached(asked) {
  try {
    return await asked;
  } catch {
    throw new Refused("", 0); // nobody there: said in the page's language by whoever asked
  }
}

async function answered(answer) {
  let said = null;
  try {
    said = await answer.json();
  } catch {
    throw new Refused(`${answer.status} ${answer.statusText}`, answer.status);
  }
  if (said.ok !== true) throw new Refused(String(said.error ?? answer.statusText), answer.status);
  return said;
}
