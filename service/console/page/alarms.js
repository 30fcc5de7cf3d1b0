// The alarm list: reason, value, limit, time, what to do; what came first; what nobody has seen yet flashes and sounds.

import { ago, utc } from "./format.js";

const $ = (id) => document.getElementById(id);
const BEEP_MS = 1500;

export class Alarms {
  #beeping = null;
  #shown = "";
  #made = new Map();
  sounds = false;

  constructor(acknowledge) {
    this.acknowledge = acknowledge;
    $("ackall").onclick = () => acknowledge(null);
  }

  told(state, epochMs, mayControl) {
    const fresh = state.alarms.filter((a) => !a.acknowledged).sort((a, b) => Number(b.active) - Number(a.active));
    $("alarmcount").textContent = state.alarms.length
      ? `${state.alarms.length} alarm${state.alarms.length > 1 ? "s" : ""}, ${fresh.length} not acknowledged`
      : "no alarms";
    $("ackall").hidden = !fresh.length || !mayControl;
    this.#first = fresh[0]?.key ?? null;
    this.#beep(fresh.length > 0);
    const now = JSON.stringify([state.alarms.map((a) => ({ ...a, age_s: Math.floor(a.age_s) })), state.first_out?.key]);
    if (now === this.#shown) return;
    this.#shown = now;
    const rows = this.#rows(state, epochMs, mayControl);
    this.#made = new Map(rows.map((row) => [row.dataset.key, row]));
    const list = $("alarmlist");
    if (rows.length === list.children.length && rows.every((row, i) => row === list.children[i])) return;
    const focused = document.activeElement?.dataset?.key;
    list.replaceChildren(...rows);
    if (focused) list.querySelector(`button[data-key="${CSS.escape(focused)}"]`)?.focus();
  }

  #first = null;

  acknowledgeFirst() {
    if (this.#first !== null) this.acknowledge(this.#first);
  }

  #rows(state, epochMs, mayControl) {
    const listed = [...state.alarms].sort((a, b) => Number(b.active) - Number(a.active)); // what is gone can wait
    const first = state.first_out, kept = first && !state.alarms.some((a) => a.key === first.key);
    const rows = listed.map((a) => this.#row(a, a.key === first?.key, epochMs, mayControl));
    if (kept) rows.push(this.#row({ ...first, active: false, acknowledged: true }, true, epochMs, false));
    return rows;
  }

  /** An alarm's row, the same as long as it is listed: a click whose press and release meet two buttons is none. */
  #row(a, first, epochMs, mayControl) {
    const row = this.#made.get(a.key) ?? this.#newRow(a.key);
    row.className = `${a.acknowledged ? "" : "new"} ${a.active ? "" : "gone"}`;
    row.querySelector(".first").hidden = !first;
    const figure = a.value === null ? "" : ` ${a.value.toFixed(2)} ${a.unit}${a.limit === null ? "" : `, limit ${a.limit} ${a.unit}`}`;
    row.querySelector(".reason").textContent = a.reason + (figure ? `:${figure}` : "");
    row.querySelector(".todo").textContent = `→ ${a.todo}`;
    const seen = a.acknowledged ? "acknowledged" : "not acknowledged";
    row.querySelector(".when").textContent =
      `${utc(epochMs + a.raised_ms)} UTC, ${ago(a.age_s)} ago${a.active ? "" : " · GONE"} · ${seen}${a.times > 1 ? ` · ${a.times}×` : ""}`;
    row.querySelector("button").hidden = a.acknowledged || !mayControl;
    return row;
  }

  #newRow(key) {
    const row = document.createElement("li");
    row.dataset.key = key;
    row.innerHTML =
      '<svg><use href="#octagon"/></svg><div><div class="what"><span class="first">FIRST</span><span class="reason"></span></div>' +
      '<div class="todo"></div><div class="when"></div></div><button type="button">Ack <kbd>K</kbd></button>';
    const button = row.querySelector("button");
    button.dataset.key = key;
    button.onclick = () => this.acknowledge(key);
    return row;
  }

  /** Switch the sound on or off; to be called by a key or click, without which browsers stay silent. */
  toggleSound() {
    this.sounds = !this.sounds;
    if (this.sounds) {
      this.audio ??= new AudioContext();
      this.audio.resume();
      this.#tone(660, 0.08);
    }
    return this.sounds;
  }

  #beep(wanted) {
    const on = wanted && this.sounds;
    if (on && this.#beeping === null) {
      const once = () => {
        this.#tone(880, 0.16);
        this.#tone(620, 0.16, 0.2);
      };
      once();
      this.#beeping = setInterval(once, BEEP_MS);
    } else if (!on && this.#beeping !== null) {
      clearInterval(this.#beeping);
      this.#beeping = null;
    }
  }

  #tone(hz, seconds, after = 0) {
    const start = this.audio.currentTime + after, tone = this.audio.createOscillator(), loud = this.audio.createGain();
    tone.frequency.value = hz;
    loud.gain.setValueAtTime(0.25, start);
    loud.gain.linearRampToValueAtTime(0, start + seconds);
    tone.connect(loud).connect(this.audio.destination);
    tone.start(start);
    tone.stop(start + seconds);
  }
}
