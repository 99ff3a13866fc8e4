// The page: what the daemon tells is kept, and drawn with the screen.

import { Connection } from "/connection.js";
import { Controls } from "/controls.js";
import { Applications } from "/applications.js";
import { showDelay, showRows } from "/figures.js";
import { Mapping } from "/mapping.js";
import { Meters } from "/meters.js";
import { SyncTest } from "/sync.js";
import { still } from "/drawing.js";
import { Waterfall } from "/waterfall.js";

const STATES = {
  starting: ["Starting", "wait"], running: ["Running", "good"], idle: ["Idle", "good"],
  "waiting-for-server": ["Waiting for the sound server", "wait"], "waiting-for-device": ["Waiting for the device", "wait"],
  "waiting-for-sound-source": ["Waiting for a sound source", "wait"], recovering: ["Recovering", "wait"], stopping: ["Stopping", "wait"],
};
const CHANNELS = { 1: ["mono"], 2: ["L", "R"], 4: ["FL", "FR", "RL", "RR"], 6: ["FL", "FR", "C", "LFE", "RL", "RR"], 8: ["FL", "FR", "C", "LFE", "RL", "RR", "SL", "SR"] };
const STILL_MS = 250;
const STALE_MS = 1500;

const find = (id) => document.getElementById(id);
const mapping = new Mapping(find("mapping"), find("strongest"));
const waterfall = new Waterfall(find("waterfall"));
const soundMeters = new Meters(find("sound-meters"), "Sound", (index, count) => CHANNELS[count]?.[index] ?? `${index + 1}`);
const vibrationMeters = new Meters(find("vibration-meters"), "Vibration", (index, count) => (count > 1 ? `${index + 1}` : "all"));
const connection = new Connection(listen);
const ask = (request) => connection.ask(request);
const controls = new Controls(find("controls"), ask);
const applications = new Applications(find("applications"), ask, tell);
const sync = new SyncTest(ask, async () => {
  if (typeof valueOf("offset_ms") === "number") await act({ set: { offset_ms: null } }); // a number would win
});

let frame = null, fresh = false, link = { connected: false, text: "" }, status = null, settings = null, muted = false, toned = false;
let traffic = { overwritten: 0, missed: 0 }, drawn = 0, drawnAt = 0, arrivedAt = 0, counted = performance.now();
window.cushion = { frames: 0, partials: [] }; // what tests measure

function listen(kind, content) {
  if (kind === "frame") {
    frame = readable(content);
    fresh = true;
    arrivedAt = performance.now();
    waterfall.add(frame.partials, arrivedAt);
    window.cushion.partials = frame.partials;
    if (status && status.state !== content.state) {
      status = { ...status, state: content.state, reason: "" };
      showState();
    }
  } else if (kind === "traffic") {
    traffic = content;
  } else if (kind === "status") {
    showStatus(content);
  } else if (kind === "figures") {
    showFigures(content);
  } else if (kind === "settings") {
    showSettings(content);
  } else if (kind === "link") {
    link = content;
    if (!link.connected) status = settings = null;
    showState();
  }
}

/** Levels in dBFS, partials as they are played, with names, the strongest first. */
function readable(content) {
  const decibels = (power) => Math.max(-150, 10 * Math.log10(power));
  const levels = (readings) => readings.map(([peak, square]) => [decibels(peak * peak), decibels(square)]);
  const partials = content.partials.map(([audio, felt, amplitude]) => ({ audio, felt, amplitude: content.level * amplitude }));
  partials.sort((one, other) => other.amplitude - one.amplitude);
  return { sound: levels(content.sound), vibration: levels(content.level ? content.vibration : content.vibration.map(() => [0, 0])), partials };
}

const valueOf = (name) => settings?.keys.find(({ key }) => key === name)?.value;

function showState() {
  const [word, tone] = status ? STATES[status.state] ?? [status.state, "wait"] : link.connected ? ["Connecting", "wait"] : ["Not connected", "bad"];
  const ends = status && `${(status.tap.name ?? status.tap.address).replace(/\.monitor$/, "")} is felt on ${status.device.name ?? status.device.address}`;
  find("state-word").textContent = muted && status ? `${word}, switched off` : word;
  find("state-text").textContent = status ? status.reason || ends : link.text;
  find("state").dataset.tone = muted && status ? "wait" : tone;
  document.body.dataset.stale = !status;
  for (const id of ["power", "tone", "sync"]) find(id).disabled = !status;
  find("undo").disabled = !status || !settings?.undo;
  find("save").disabled = !status || !settings?.unsaved;
  find("unsaved").textContent = !status ? "No connection" : settings?.unsaved ? `Not saved: ${controls.unsaved.join(", ")}` : "All is saved";
  find("bar").dataset.unsaved = Boolean(status && settings?.unsaved);
}

function showStatus(content) {
  if (content.error) return;
  status = content;
  showState();
  showTogether();
  const why = status.engine_reason ? `: ${status.engine_reason}` : "";
  find("engine").textContent = status.engine ? `The ${status.engine} engine plays${why}. ${place(status)}Profile ${status.profile}. Version ${status.version}.` : "No engine plays yet.";
}

/** What needs both the status and the settings. */
function showTogether() {
  if (!status || !settings) return;
  controls.showOffset(status.offset_ms ?? 0, status.offset_reason ?? "");
  applications.show(status.applications, settings.keys.find(({ key }) => key === "profile")?.schema.enum ?? []);
}

function showFigures({ panels, parts }) {
  showDelay(parts);
  showRows(find("health"), panels.health);
  showRows(find("rig-figures"), panels.rig);
  find("rig").hidden = !panels.rig.length;
}

function place({ graph, server }) {
  if (!graph?.samplerate) return server ? `${server}. ` : "";
  const way = graph.tap === "streams" ? "The streams are tapped" : "The sink's monitor is tapped, one cycle later";
  return `${way}. ${server}, ${graph.cycle_frames} frames at ${graph.samplerate} Hz a cycle. `;
}

function showSettings(content) {
  settings = content;
  controls.show(settings);
  [muted, toned] = [settings.muted, settings.tone];
  find("power").setAttribute("aria-checked", !muted);
  find("power-word").textContent = muted ? "Vibration is off" : "Vibration is on";
  find("tone").textContent = toned ? "Stop the tone" : "Start the tone";
  find("tone").setAttribute("aria-pressed", toned);
  showState();
  showTogether();
}

async function act(request, place = find("notice")) {
  tell(await ask(request), place);
}

function tell(answer, place = find("notice")) {
  place.textContent = answer.error ?? "";
  if (place.id === "notice") place.hidden = !answer.error;
}

function draw(now) {
  requestAnimationFrame(draw);
  if (still.matches && now - drawnAt < STILL_MS) return;
  const stale = now - arrivedAt > STALE_MS;
  if (!fresh && !stale) return;
  if (stale && now - drawnAt < 100) return;
  if (stale) waterfall.add([], now);
  [fresh, drawnAt] = [false, now];
  const shown = stale || !frame ? { sound: [], vibration: [], partials: [] } : frame;
  mapping.draw(shown.partials, now);
  waterfall.draw(now);
  soundMeters.draw(shown.sound, now);
  vibrationMeters.draw(shown.vibration, now);
  drawn++;
  window.cushion.frames++;
  if (now - counted > 1000) {
    const rate = (1000 * drawn) / (now - counted);
    find("traffic").textContent = `${rate.toFixed(0)} frames a second, ${traffic.overwritten + traffic.missed} overwritten by newer ones`;
    [counted, drawn] = [now, 0];
  }
}

const THEMES = ["system", "dark", "light"], systemLight = matchMedia("(prefers-color-scheme: light)");
function showTheme() {
  const chosen = localStorage.getItem("theme") ?? "system";
  document.documentElement.dataset.theme = chosen === "system" ? (systemLight.matches ? "light" : "dark") : chosen;
  find("theme").textContent = `Colours: ${chosen}`;
  find("theme").setAttribute("aria-label", `Colours: ${chosen}`);
}
systemLight.onchange = showTheme;
find("theme").onclick = () => {
  const chosen = localStorage.getItem("theme") ?? "system";
  localStorage.setItem("theme", THEMES[(THEMES.indexOf(chosen) + 1) % THEMES.length]);
  showTheme();
};
find("power").onclick = () => act({ mute: !muted });
find("sync").onclick = () => sync.begin(status.offset_ms ?? 0);
find("undo").onclick = () => act({ undo: true });
find("save").onclick = () => act({ save: true });
find("tone-hz").oninput = () => { find("tone-hz").style.setProperty("--fill", `${(find("tone-hz").value - 20) / 2}%`); find("tone-value").textContent = `${find("tone-hz").value} Hz`; };
find("tone").onclick = () => act({ tone: toned ? null : { hz: Number(find("tone-hz").value) } }, find("tone-error"));

showTheme();
connection.open();
requestAnimationFrame(draw);

const autostart = find("autostart");

/** Ask the page's server whether the daemon starts at login; `on` true or false switches it. */
async function startAtLogin(on) {
  const answer = await connection.ask({ autostart: on });
  if ("autostart" in answer) autostart.checked = answer.autostart;
  else if (on !== null) {
    autostart.checked = !on;
    find("notice").textContent = answer.error;
    find("notice").hidden = false;
  }
  autostart.disabled = !("autostart" in answer) && on === null;
  if (autostart.disabled) setTimeout(() => startAtLogin(null), 1000);
}

autostart.onchange = () => startAtLogin(autostart.checked);
startAtLogin(null);
