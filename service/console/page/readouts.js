// Everything about the picture: verdict, figures with their sigma and quality, vitals, banners.

import { ago, parts, putBig, signed, utc, withSigma } from "./format.js";
import { Dial, drawTrend } from "./dials.js";
import { KINDS, nameAt } from "./picture.js";

const $ = (id) => document.getElementById(id);
const SHAPES = { good: "tick", uncertain: "question", bad: "cross", stale: "clock" };
const AMBER_MS = 150, RED_MS = 300;
const TREND = { offset: 1, tilt: 3, distance: 5 };
const CAMERA_LEVEL = Object.assign([5, 10], { plain: true });
const STOP = { "NO SIGNAL": "octagon", FROZEN: "octagon", STALE: "clock", RECONNECTING: "clock", STARTING: "clock", ENDED: "cross" };

export class Readouts {
  #bullseye = new Dial($("bullseye"), false);
  #level = new Dial($("level"), true);
  #points = [];
  #textMs = -Infinity;
  #trendMs = -Infinity;

  hello(said) {
    this.said = said;
    this.#points = said.trend;
    document.body.classList.toggle("replay", said.kind === "REPLAY");
    document.body.classList.toggle("simulated", said.kind === "SIMULATED");
    const words = { REPLAY: "REPLAY – a recording, not live", SIMULATED: "SIMULATED – no camera" }[said.kind];
    $("kindstrip").hidden = !words;
    const text = document.createElement("span");
    text.textContent = words ?? "";
    $("kindstrip").replaceChildren(text);
    document.title = `${said.kind} ${said.source} – Bowlsight`;
  }

  /** Take a frame: dials at once, words at a pace that can be read. */
  frame(head, marks, nowMs) {
    this.head = head;
    if (head.trend) {
      this.#points.push(head.trend);
      while (this.#points.length && this.#points[0][0] < head.trend[0] - 61000) this.#points.shift();
    }
    const dead = document.body.classList.contains("dead"); // frozen frames have numbers too
    if (!dead) $("hand").setAttribute("transform", `rotate(${(head.sequence % 30) * 12})`);
    this.#dials(head);
    if (nowMs - this.#textMs < 120) return;
    this.#textMs = nowMs;
    this.#verdict(head);
    this.#figures(head, marks);
    this.#identity(head);
  }

  #dials(head) {
    const a = head.alignment, b = this.said.bands, p = head.pose;
    this.#bullseye.draw(a?.offset_picture_mm, a?.offset_spread_mm2, b ? [b.offset_normal_mm, b.offset_advisory_mm] : [1, 2], "mm",
      b ? "not measured" : "no guide is set up:\nbowlsight align-setup\nmeasures it");
    if (b) this.#level.draw(a?.tilt_picture_deg, null, [b.tilt_normal_deg, b.tilt_advisory_deg], "deg", "not measured");
    else this.#level.draw(p?.tilt_picture_deg, null, CAMERA_LEVEL, "deg", "not measured");
  }

  #verdict(head) {
    const a = head.alignment;
    const show = (word, shape, level, text) => {
      $("verdict").className = `panel ${level}`;
      $("verdictshape").setAttribute("href", `#${shape}`);
      $("verdictword").textContent = word;
      $("advice").textContent = text;
    };
    if (!a) {
      const none = head.lock === "none";
      show(none ? "NO LOCK" : this.said.bands ? "NOT JUDGED" : "WATCHING", "question", "none", none ? (head.why ?? "") : "No guide is set up: tubes and distance are measured, nothing is said of alignment.");
      return;
    }
    const help = a.help.length ? ` — ${a.help.join(", or ")}` : "";
    const why = a.reasons.join("; ");
    if (a.verdict === "aligned") show("ALIGNED", "tick", "fine", `${a.name ?? a.target}: offset, tilt and entry are within their bands`);
    else if (a.verdict === "adjust") show(a.advice.split(";")[0] || "ADJUST", a.grade === "alarm" ? "octagon" : "triangle", a.grade === "alarm" ? "alarm" : "warn", ["ADJUST", a.advice.split(";").slice(1).join(";").trim(), why].filter(Boolean).join(" — "));
    else show(a.verdict.toUpperCase(), a.verdict === "stale" ? "clock" : "question", "none", why + help);
  }

  #figures(head, marks) {
    const a = head.alignment, p = head.pose, b = this.said.bands;
    putBig($("offset"), a?.offset_mm, a?.offset_sigma_mm, "mm");
    $("offsetparts").textContent = a?.offset_picture_mm ? parts(a.offset_picture_mm, "mm") : "";
    const tilt = b ? [a?.tilt_deg, a?.tilt_sigma_deg] : [p?.tilt_deg, p?.tilt_sigma_deg];
    putBig($("tilt"), tilt[0], tilt[1], "°");
    const leans = b ? a?.tilt_picture_deg : p?.tilt_picture_deg;
    $("tilttitle").textContent = b ? "guide's tilt" : "camera's tilt";
    $("tiltparts").textContent = leans ? parts(leans, "°") : "";
    $("offset").parentElement.classList.toggle("none", !a?.offset_mm);
    this.#quality($("offsetquality"), a ? a.quality : b ? "bad" : null);
    this.#quality($("tiltquality"), b ? (a?.quality ?? "bad") : { full: "good", partial: "uncertain", none: "bad" }[head.lock]);
    $("parallelism").textContent = withSigma(a?.parallelism_deg, a?.parallelism_sigma_deg, "°");
    const off = b && a?.parallelism_deg > b.parallelism_normal_deg + 2 * a.parallelism_sigma_deg;
    $("parallelism").classList.toggle("alarm", Boolean(off));
    $("margin").textContent = a?.margin_mm === undefined || a?.margin_mm === null ? "–" : `${signed(a.margin_mm)} ± ${a.margin_sigma_mm.toFixed(2)} mm`;
    $("margin").classList.toggle("alarm", a?.margin_mm < 0);
    $("distance").textContent = withSigma(p?.distance_mm, p?.distance_sigma_mm, "mm");
    const counts = KINDS.map(() => 0);
    for (let i = 6; i < marks.length; i += 9) counts[marks[i]] += 1;
    $("tubes").textContent = `${counts[0]} seen + ${counts[1]}`;
    $("legend").textContent = `○ measured   ◌ predicted   ⊗ plugged ${counts[2]}   ▫ absent ${counts[3]}   ⌜⌟ target   + probe`;
    $("lock").textContent = head.lock;
    $("lock").parentElement.classList.toggle("warn", head.lock === "partial");
    $("lock").parentElement.classList.toggle("alarm", head.lock === "none");
  }

  /** A shape and a word; what is not live says so beside every figure. */
  #quality(element, quality) {
    if (!quality) {
      element.textContent = "";
      return;
    }
    const where = { REPLAY: " · replay", SIMULATED: " · simulated" }[this.said.kind] ?? "";
    const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
    const use = document.createElementNS("http://www.w3.org/2000/svg", "use");
    use.setAttribute("href", `#${SHAPES[quality]}`);
    svg.setAttribute("width", "12");
    svg.setAttribute("height", "12");
    svg.append(use);
    element.className = "quality";
    element.replaceChildren(svg, `${quality}${where}`);
  }

  #identity(head) {
    const said = this.said, a = head.alignment, place = head.target;
    const name = place ? nameAt(head, place[0], place[1]) : "no target";
    const prefix = [said.steam_generator, said.leg].filter(Boolean).join(" ");
    const named = Boolean(place && head.names);
    $("tube").textContent = named ? `${prefix} ${name}`.trim() : name;
    const approximate = a?.map_approximate ?? said.map?.approximate;
    $("identity").classList.toggle("approximate", named && Boolean(approximate));
    const view = said.rows_grow ? `seen from the bowl; ${said.naming === "line-row" ? "lines" : "columns"} grow ${said.columns_grow}, rows ${said.rows_grow}` : "seen from the bowl; handedness not set";
    const map = !named ? "not named: anchor a tube (A)" : said.map ? `map ${said.map.name}${approximate ? " (APPROXIMATE)" : ""}${a?.on_map === false ? ": NO SUCH TUBE ON IT" : ""}` : "no map";
    const how = said.bands && this.state?.target === "nearest" ? "nearest to the guide · " : "";
    $("where").textContent = `${how}${map} · ${view}`;
    $("identity").classList.toggle("warn", a?.on_map === false);
  }

  /** Take the state: what does not come with a picture. */
  told(state) {
    this.state = state;
    $("rate").textContent = `${state.capture_fps.toFixed(1)} /s`;
    $("lost").textContent = `${state.dropped}${state.bad ? ` + ${state.bad} bad` : ""}`;
    $("utc").textContent = utc(this.said.epoch_ms + state.now_ms);
    const r = state.recording, box = $("recording");
    box.classList.toggle("on", Boolean(r?.on));
    box.classList.toggle("alarm", Boolean(r?.failure));
    $("recorded").textContent = !r ? "none" : r.failure ? "STOPPED" : r.on ? `REC ${r.evidence} rec.` : "off";
    box.title = r?.failure ?? r?.session ?? "";
    $("recordword").textContent = r?.on ? "Stop recording" : "Record";
  }

  /** Say what the picture is worth; several times a second, whether or not anything arrives. */
  live(l, latencyMs, nowMs) {
    const dead = !l.fine;
    document.body.classList.toggle("dead", dead);
    document.body.classList.remove("waiting");
    $("heartbeat").classList.toggle("bad", dead);
    $("liveness").textContent = l.word;
    document.body.dataset.liveness = l.word;
    $("banner").hidden = !dead;
    if (dead) {
      $("banner").querySelector("use").setAttribute("href", `#${STOP[l.word] ?? "octagon"}`);
      $("bannerword").textContent = l.word;
      $("bannerwhy").textContent = l.why;
      $("bannerage").textContent = l.ageMs === null || !Number.isFinite(l.ageMs) ? "" : `the picture is ${ago(l.ageMs / 1000)} old`;
    }
    const late = dead ? null : latencyMs;
    $("latency").textContent = late === null ? "–" : `${late > RED_MS ? "✖ " : late > AMBER_MS ? "▲ " : ""}${Math.round(late)} ms`;
    $("latency").parentElement.className = late > RED_MS ? "alarm" : late > AMBER_MS ? "warn" : "";
    if (nowMs - this.#trendMs > 200 && this.said) {
      this.#trendMs = nowMs;
      this.trends(nowMs);
    }
  }

  trends(nowMs) {
    const b = this.said.bands;
    if (b) {
      drawTrend($("trendone"), this.#points, TREND.offset, "offset", "mm", [b.offset_normal_mm, b.offset_advisory_mm], nowMs);
      drawTrend($("trendtwo"), this.#points, TREND.tilt, "tilt", "°", [b.tilt_normal_deg, b.tilt_advisory_deg], nowMs);
    } else {
      drawTrend($("trendone"), this.#points, TREND.distance, "distance", "mm", [], nowMs);
      drawTrend($("trendtwo"), this.#points, TREND.tilt, "camera tilt", "°", [], nowMs);
    }
  }
}
