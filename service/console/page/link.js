// The line to the service: messages in, receipts out, and its clock as far as it can be told from here.

const TEXT = new TextDecoder();
const MARK_NUMBERS = 9;

/** Where a message's head, marks and picture are; see service/console/message.py. */
export function unpack(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const head = JSON.parse(TEXT.decode(new Uint8Array(buffer, 4, length)));
  const marks = new Int16Array(buffer, 4 + length, head.tubes * MARK_NUMBERS);
  const picture = new Uint8Array(buffer, 4 + length + marks.byteLength);
  return { head, marks, picture };
}

/** The service's monotonic clock, from the quickest of the last answers to "what time is it". */
export class Clock {
  #answers = [];
  synced = false;
  offset = 0;

  answered(askedMs, serviceMs, nowMs) {
    this.#answers.push({ trip: nowMs - askedMs, offset: serviceMs - (askedMs + nowMs) / 2 });
    if (this.#answers.length > 30) this.#answers.shift();
    this.offset = this.#answers.reduce((a, b) => (b.trip < a.trip ? b : a)).offset;
    this.synced = true;
  }

  now() {
    return performance.now() + this.offset;
  }
}

export class Link {
  #socket = null;
  #received = 0;
  #pings = 0;
  clock = new Clock();
  lastMs = -Infinity;

  /** `on` has: frame(buffer), text(object), opened(), closed(code, reason). */
  constructor(on) {
    this.on = on;
    setInterval(() => this.#ping(), 1000);
    this.#open();
  }

  #open() {
    const socket = new WebSocket(`ws://${location.host}/live`);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.#received = 0;
      this.clock = new Clock();
      for (let i = 0; i < 5; i++) setTimeout(() => this.#ping(), 100 * i);
      this.on.opened();
    };
    socket.onmessage = (event) => this.#take(event.data);
    socket.onclose = (event) => {
      this.on.closed(event.code, event.reason);
      if (event.reason !== "token") setTimeout(() => this.#open(), 1000);
    };
    this.#socket = socket;
  }

  reopen() {
    this.#open();
  }

  #take(data) {
    this.lastMs = performance.now();
    if (typeof data !== "string") {
      this.#received += 1;
      this.on.frame(data, this.#received);
      return;
    }
    const said = JSON.parse(data);
    if (said.type === "pong") this.clock.answered(said.ping, said.now_ms, performance.now());
    else this.on.text(said);
  }

  /** Say that the frame numbered so was drawn: the next may come. */
  seen(number) {
    this.#send({ seen: number });
  }

  #ping() {
    this.#send({ ping: performance.now() });
  }

  #send(message) {
    if (this.#socket?.readyState === WebSocket.OPEN) this.#socket.send(JSON.stringify(message));
  }
}

/** Ask the service for something; gives its answer, or throws what it says. */
export async function command(name, body) {
  let answer;
  try {
    answer = await fetch(`/api/${name}`, {
      method: "POST",
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify(body),
    });
  } catch {
    throw new Error("the service does not answer");
  }
  const said = await answer.json().catch(() => ({}));
  if (!answer.ok) throw new Error(said.error ?? `refused (${answer.status})`);
  return said;
}
