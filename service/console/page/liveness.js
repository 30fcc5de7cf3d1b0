// What the picture is worth, and what says so: the service, and this page's own watch over what reaches it.

const SILENT_MS = 1000;
const FINE = new Set(["LIVE", "REPLAY", "SIMULATED"]);

/**
 * The word to show, why, and since when (ms ago; null: unknown). `fine`: pictures come and are what they claim to be.
 * The page believes its own evidence first: a service that says LIVE and sends nothing is not live.
 */
export function liveness(kind, state, connected, messageAgeMs, frameAgeMs) {
  if (!connected) return { word: "STALE", why: "no line to the service; this page tries again by itself", ageMs: frameAgeMs };
  if (messageAgeMs > SILENT_MS) return { word: "STALE", why: "no message from the service", ageMs: messageAgeMs };
  if (!state) return { word: "STARTING", why: "waiting for the service", ageMs: null };
  if (!FINE.has(state.liveness)) {
    const ageMs = state.since_ms === null ? null : state.now_ms - state.since_ms + messageAgeMs;
    return { word: state.liveness, why: state.reason, ageMs };
  }
  if (frameAgeMs > SILENT_MS) return { word: "STALE", why: "no new picture reaches this page", ageMs: frameAgeMs };
  return { word: kind, why: "", ageMs: null, fine: true };
}
