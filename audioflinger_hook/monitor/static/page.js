// The page: what the daemon tells is kept, and drawn with the screen.

import { Applications, nameOf } from "./applications.js";
import { Connection } from "./connection.js";
import { Controls } from "./controls.js";
import { fill, find } from "./elements.js";
import { showDelay, showRows } from "./figures.js";
import { Panels } from "./panels.js";
import { SyncTest } from "./sync.js";
import { followTheme } from "./theme.js";

const STATES = {
  starting: ["Starting", "wait"], running: ["Running", "good"], idle: ["Idle", "good"],
  "waiting-for-server": ["Waiting for the sound server", "wait"], "waiting-for-device": ["Waiting for the device", "wait"],
  "waiting-for-sound-source": ["Waiting for a sound source", "wait"], recovering: ["Recovering", "wait"], stopping: ["Stopping", "wait"],
};

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
const panels = new Panels((rate) => {
  find("traffic").textContent = `${rate.toFixed(0)} frames a second, ${traffic.overwritten + traffic.missed} overwritten by newer ones`;
});
const controls = new Controls(find("controls"), ask);
const applications = new Applications(find("applications"), (application) => act({ application }));
const sync = new SyncTest(ask, async () => {
  if (typeof keyOf("offset_ms")?.value === "number") await act({ set: { offset_ms: null } }); // a number would win
});
const keyOf = (name) => settings?.keys.find(({ key }) => key === name);

let link = { connected: false, text: "" }, status = null, settings = null, traffic = { overwritten: 0, missed: 0 };

function showFrame(content) {
  panels.show(content);
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
find("power").onclick = () => act({ mute: !settings?.muted });
find("sync").onclick = () => sync.begin(status.offset_ms ?? 0);
find("undo").onclick = () => act({ undo: true });
find("save").onclick = async () => {
  while (controls.busy) await new Promise((resume) => setTimeout(resume, 20));
  act({ save: true });
};
find("tone-hz").oninput = ({ target }) => { fill(target); find("tone-value").textContent = `${target.value} Hz`; };
find("tone").onclick = () => act({ tone: settings?.tone ? null : { hz: Number(find("tone-hz").value) } }, find("tone-error"));
find("autostart").onchange = ({ target }) => startAtLogin(target.checked);

followTheme(find("theme"));
connection.open();
startAtLogin(null);
