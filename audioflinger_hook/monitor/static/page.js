// The page: what the daemon tells is kept, and drawn with the screen.

import { Applications, nameOf } from "/applications.js";
import { Connection } from "/connection.js";
import { Controls } from "/controls.js";
import { still } from "/drawing.js";
import { fill, find } from "/elements.js";
import { showDelay, showRows } from "/figures.js";
import { Mapping } from "/mapping.js";
import { Meters } from "/meters.js";
import { SyncTest } from "/sync.js";
import { Waterfall } from "/waterfall.js";

const STATES = {
  starting: ["Starting", "wait"], running: ["Running", "good"], idle: ["Idle", "good"],
  "waiting-for-server": ["Waiting for the sound server", "wait"], "waiting-for-device": ["Waiting for the device", "wait"],
  "waiting-for-sound-source": ["Waiting for a sound source", "wait"], recovering: ["Recovering", "wait"], stopping: ["Stopping", "wait"],
};
const CHANNELS = { 1: ["mono"], 2: ["L", "R"], 4: ["FL", "FR", "RL", "RR"], 6: ["FL", "FR", "C", "LFE", "RL", "RR"], 8: ["FL", "FR", "C", "LFE", "RL", "RR", "SL", "SR"] };
const STILL_MS = 250, STALE_MS = 1500, STALE_EVERY_MS = 100;
const NOTHING = { sound: [], vibration: [], partials: [] };
const THEMES = ["system", "dark", "light"];

const listeners = {
  frame: showFrame, status: showStatus, figures: showFigures, settings: showSettings,
  traffic: (content) => { traffic = content; },
  link: (content) => {
    link = content;
    if (!link.connected) status = settings = null;
    showState();
  },
};
const connection = new Connection((kind, content) => listeners[kind]?.(content));
const ask = (request) => connection.ask(request);
const act = async (request, place) => tell(await ask(request), place);
const mapping = new Mapping(find("mapping"), find("strongest"));
const waterfall = new Waterfall(find("waterfall"));
const soundMeters = new Meters(find("sound-meters"), "Sound", (index, count) => CHANNELS[count]?.[index] ?? `${index + 1}`);
const vibrationMeters = new Meters(find("vibration-meters"), "Vibration", (index, count) => (count > 1 ? `${index + 1}` : "all"));
const controls = new Controls(find("controls"), ask);
const applications = new Applications(find("applications"), (application) => act({ application }));
const sync = new SyncTest(ask, async () => {
  if (typeof keyOf("offset_ms")?.value === "number") await act({ set: { offset_ms: null } }); // a number would win
});
const keyOf = (name) => settings?.keys.find(({ key }) => key === name);

let frame = NOTHING, fresh = false, link = { connected: false, text: "" }, status = null, settings = null;
let traffic = { overwritten: 0, missed: 0 }, drawn = 0, drawnAt = 0, arrivedAt = 0, counted = performance.now();
window.cushion = { frames: 0, partials: [] }; // what tests measure

/** Levels in dBFS, partials as they are played, with names, the strongest first. */
function showFrame(content) {
  const decibels = (power) => Math.max(-150, 10 * Math.log10(power));
  const levels = (readings, level = 1) => readings.map(([peak, square]) => (level ? [decibels(peak * peak), decibels(square)] : [-150, -150]));
  const partials = content.partials.map(([audio, felt, amplitude]) => ({ audio, felt, amplitude: content.level * amplitude }));
  partials.sort((one, other) => other.amplitude - one.amplitude);
  frame = { sound: levels(content.sound), vibration: levels(content.vibration, content.level), partials };
  [fresh, arrivedAt, window.cushion.partials] = [true, performance.now(), partials];
  waterfall.add(partials, arrivedAt);
  if (!status || status.state === content.state) return;
  status = { ...status, state: content.state, reason: "" };
  showState();
}

function showState() {
  const [word, tone] = status ? STATES[status.state] ?? [status.state, "wait"] : link.connected ? ["Connecting", "wait"] : ["Not connected", "bad"];
  const ends = status && `${(status.tap.name ?? status.tap.address).replace(/\.monitor$/, "")} is felt on ${status.device.name ?? status.device.address}`;
  const isOff = status && settings?.muted, names = [...controls.unsaved, ...(settings?.unsaved_rules ?? []).map(nameOf)];
  find("state-word").textContent = isOff ? `${word}, switched off` : word;
  find("state-text").textContent = status ? status.reason || ends : link.text;
  find("state").dataset.tone = isOff ? "wait" : tone;
  document.body.dataset.stale = !status;
  for (const id of ["power", "tone"]) find(id).disabled = !status;
  find("sync").disabled = !["running", "idle"].includes(status?.state) || settings?.muted; // a trial must be felt
  find("undo").disabled = !status || !settings?.undo;
  find("save").disabled = !status || !settings?.unsaved;
  find("unsaved").textContent = !status ? "No connection" : settings?.unsaved ? `Not saved: ${names.join(", ")}` : "All is saved";
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
  applications.show(status.applications, settings, keyOf("profile")?.schema.enum ?? []);
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
  find("power").setAttribute("aria-checked", !settings.muted);
  find("power-word").textContent = settings.muted ? "Vibration is off" : "Vibration is on";
  find("tone").textContent = settings.tone ? "Stop the tone" : "Start the tone";
  find("tone").setAttribute("aria-pressed", settings.tone);
  showState();
  showTogether();
}

function tell({ error = "" }, place = find("notice")) {
  place.textContent = error;
  if (place.id === "notice") place.hidden = !error;
}

function draw(now) {
  requestAnimationFrame(draw);
  const stale = now - arrivedAt > STALE_MS, wait = still.matches ? STILL_MS : stale ? STALE_EVERY_MS : 0;
  if (now - drawnAt < wait || !(fresh || stale)) return;
  if (stale) waterfall.add([], now);
  [fresh, drawnAt] = [false, now];
  const shown = stale ? NOTHING : frame;
  mapping.draw(shown.partials, now);
  waterfall.draw(now);
  soundMeters.draw(shown.sound, now);
  vibrationMeters.draw(shown.vibration, now);
  drawn++;
  window.cushion.frames++;
  if (now - counted <= 1000) return;
  const rate = (1000 * drawn) / (now - counted);
  find("traffic").textContent = `${rate.toFixed(0)} frames a second, ${traffic.overwritten + traffic.missed} overwritten by newer ones`;
  [counted, drawn] = [now, 0];
}

const theme = find("theme"), systemLight = matchMedia("(prefers-color-scheme: light)");
function showTheme(step = 0) {
  const chosen = THEMES[(THEMES.indexOf(localStorage.getItem("theme") ?? "system") + step) % THEMES.length];
  if (step) localStorage.setItem("theme", chosen);
  document.documentElement.dataset.theme = chosen === "system" ? (systemLight.matches ? "light" : "dark") : chosen;
  theme.textContent = theme.ariaLabel = `Colours: ${chosen}`;
}

/** Ask the page's server whether the daemon starts at login; `on` true or false switches it. */
async function startAtLogin(on) {
  const box = find("autostart"), answer = await ask({ autostart: on });
  if (on !== null) tell(answer);
  if ("autostart" in answer || on !== null) box.checked = answer.autostart ?? !on;
  box.disabled = !("autostart" in answer) && on === null;
  if (box.disabled) setTimeout(() => startAtLogin(null), 1000);
}

/** Open a second tab. The browser gives it a copy of the key only if a script opens it. */
find("second").onclick = find("second").onauxclick = (event) => {
  if (event.button !== 2 && window.open("/")) event.preventDefault(); // 2: for the context menu
};
systemLight.onchange = () => showTheme();
theme.onclick = () => showTheme(1);
find("power").onclick = () => act({ mute: !settings?.muted });
find("sync").onclick = () => sync.begin(status.offset_ms ?? 0);
find("undo").onclick = () => act({ undo: true });
find("save").onclick = () => act({ save: true });
find("tone-hz").oninput = ({ target }) => { fill(target); find("tone-value").textContent = `${target.value} Hz`; };
find("tone").onclick = () => act({ tone: settings?.tone ? null : { hz: Number(find("tone-hz").value) } }, find("tone-error"));
find("autostart").onchange = ({ target }) => startAtLogin(target.checked);

showTheme();
connection.open();
requestAnimationFrame(draw);
startAtLogin(null);
