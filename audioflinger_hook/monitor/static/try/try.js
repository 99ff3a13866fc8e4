// The page "Try it": sound in, vibration shown, felt on a chosen output, or saved as a file.

import { element, fill, find, PROFILES, titled } from "./elements.js";
import { canChoose, outputs, SecondOutput } from "./output.js";
import { Panels } from "./panels.js";
import { RATES, wholeSound } from "./sound.js";
import { abilities, capture } from "./sources.js";
import { followTheme } from "./theme.js";

const NO_WORKLET = "This browser plays no live vibration (it lacks AudioWorklet, or the page is not on https or localhost). Files can be made.";
const NO_WASM = "This browser lacks WebAssembly with SIMD. Use a newer one.";
const ONLY_SHOWN = "Without an output, the vibration is silent and only shown.";
const RATE = RATES[1], MORE_DELAY_S = 0.02, DELAY_MAX_S = 0.3;

const player = find("player"), profile = find("profile"), output = find("output"), vibration = find("vibration");
const panels = new Panels(), second = new SecondOutput(follow), can = abilities();
let file = null, captured = null, captures = 0, context = null, preparing = null, node = null, delay = null, latency = 0, dry = 0, worker = null;

function say(text, tone = "good") {
  find("status").textContent = text;
  find("state").dataset.tone = tone;
}

/** Run what a person asked for; an Error becomes the line of the page. */
const asked = (act) => (event) => Promise.resolve(event).then(act).catch((error) => say(error.message, "bad"));

/** A file of this page, which the browser keeps for times without a network. */
async function bytesOf(name) {
  const answer = await fetch(name).catch(() => ({ ok: false }));
  if (!answer.ok) throw new Error(`${name} cannot be loaded. Connect to the network or start the server, then try again.`);
  return new Uint8Array(await answer.arrayBuffer());
}

async function designOf(rate) {
  const [wasm, design] = await Promise.all(["core.wasm", `${profile.value}-${rate}.design`].map(bytesOf));
  if (!WebAssembly.validate(wasm)) throw new Error(NO_WASM);
  navigator.serviceWorker?.controller?.postMessage("in use");
  return { wasm, design };
}

/** Open the audio context, at the first sound: a browser allows none before a click or key. */
async function prepare() {
  if (!globalThis.AudioWorkletNode) throw new Error(NO_WORKLET);
  await (preparing ??= open().catch((error) => { preparing = null; throw error; }));
  await context.resume();
}

async function open() {
  const latencyHint = captured ? "interactive" : "playback"; // sound from a file can wait, so that no interruption is heard
  context ??= new AudioContext({ latencyHint });
  if (!RATES.includes(context.sampleRate)) {
    context.close();
    context = new AudioContext({ latencyHint, sampleRate: RATE });
  }
  await context.audioWorklet.addModule(new URL("vibration.js", import.meta.url));
  delay ??= new DelayNode(context, { maxDelayTime: 1 });
  (player.source ??= new MediaElementAudioSourceNode(context, { mediaElement: player })).connect(delay).connect(context.destination);
  await transform();
}

/** Begin a transform with the chosen profile, in place of the one before. */
async function transform() {
  const chosen = profile.value, processorOptions = await designOf(context.sampleRate), before = node;
  if (profile.value !== chosen) return node || transform(); // with a node, the later choice has its own call
  node = new AudioWorkletNode(context, "vibration", { outputChannelCount: [1], channelCount: 2, channelCountMode: "explicit", processorOptions });
  node.port.onmessage = ({ data }) => show(data);
  node.onprocessorerror = () => say("The vibration has stopped: this browser is too old, or has too little memory.", "bad");
  Object.assign(window.cushion, { context, node, second }); // what tests measure
  node.connect(new GainNode(context, { gain: 0 })).connect(context.destination); // else no sound would be asked for
  for (const source of [player.source, captured?.source]) {
    if (before) source?.disconnect(before);
    source?.connect(node);
  }
  before?.disconnect();
  before?.port.postMessage({ ends: true });
  if (second.context) join();
}

const strength = () => (find("power").getAttribute("aria-checked") === "true" ? 10 ** (find("strength").value / 20) : 0);

function show(data) {
  const level = strength();
  if (!("latency" in data)) return panels.show({ ...data, vibration: data.vibration.map(([peak, square]) => [peak * level, square * level * level]), level });
  latency = data.latency;
  if (second.context) align();
}

async function choose(chosen, name = chosen.name) {
  endCapture();
  cancel();
  forget();
  file = chosen.size ? chosen : null;
  URL.revokeObjectURL(player.src);
  player.src = file ? URL.createObjectURL(file) : "";
  player.hidden = find("make").disabled = !file;
  if (!file) throw new Error(`${name} is empty (0 bytes). Choose a file with sound.`);
  say(`${name} is chosen. Play it, or make its vibration as a file.`);
}

async function scene({ target }) {
  const name = `${target.dataset.scene}.wav`, bytes = await bytesOf(name);
  await choose(new File([bytes], name, { type: "audio/wav" }), target.textContent);
  await prepare();
  await player.play();
  say(`${target.textContent} plays${second.context ? "." : "; its vibration is only shown."}`);
}

async function take({ target }) {
  const kind = target.dataset.capture;
  endCapture();
  player.pause();
  const number = captures, taken = await capture(kind, () => {
    if (captured !== taken) return;
    endCapture();
    say(`${titled(taken.label)} has ended or was unplugged. Choose a sound.`, "bad");
  });
  if (number !== captures) return taken.stop(); // another sound was chosen meanwhile
  captured = taken;
  await prepare().catch((error) => { if (captured === taken) endCapture(); throw error; });
  if (captured !== taken) return; // it was stopped meanwhile
  taken.source = new MediaStreamAudioSourceNode(context, { mediaStream: taken.stream });
  taken.source.connect(node);
  find("stop").hidden = false;
  say(`${titled(taken.label || kind)} becomes vibration.`);
}

function endCapture() {
  captured?.stop();
  captured?.source?.disconnect();
  [captured, captures] = [null, captures + 1];
  find("stop").hidden = true;
}

async function list(found) {
  const kept = output.value, known = found ?? await outputs();
  output.replaceChildren(element("option", { value: "" }, "None: only shown"),
    ...known.map(({ deviceId, label }) => element("option", { value: deviceId }, label)));
  output.value = known.some(({ deviceId }) => deviceId === kept) ? kept : "";
  if (second.deviceId && output.value !== second.deviceId) gone();
  return known;
}

async function findOutputs() {
  if (navigator.mediaDevices.selectAudioOutput) {
    const device = await navigator.mediaDevices.selectAudioOutput().catch(() => { throw new Error("No output was chosen."); });
    await list([device]);
    output.value = device.deviceId;
    return useOutput();
  }
  if (!(await outputs()).length) {
    const refused = (error) => { throw new Error(`${error.message} Browsers name the outputs only with this permission.`); };
    (await capture("microphone", () => {}).catch(refused)).stop();
  }
  const known = await list();
  say(known.length ? "Choose the output of the vibration, not your speakers." : "No second output was found. Connect one, then try again.", known.length ? "good" : "wait");
}

async function useOutput() {
  leave();
  const chosen = output.value, [option] = output.selectedOptions;
  if (!chosen) return say("The vibration is only shown.");
  output.value = ""; // until it is open
  await prepare();
  await second.open(chosen, context).catch((error) => { throw new Error(`${option.textContent} cannot be opened: ${error.message}`); });
  output.value = chosen;
  second.setGain(strength());
  tellPower();
  join();
  say(`Vibration plays on ${option.textContent}.`);
}

function join() {
  const port = second.port();
  node.port.postMessage({ to: port }, [port]);
  align();
}

function align(seconds = second.wanted(latency)) {
  delay.delayTime.value = seconds;
  Object.assign(second, { delay: seconds, latency });
}

function follow({ gone: lost, apart, ppm, dry: count }) {
  if (lost) return gone();
  if (count > dry) align(Math.min(DELAY_MAX_S, second.delay + MORE_DELAY_S)); // else it would run dry again
  dry = count;
  const clocks = Math.abs(ppm) < 1 ? "" : `; the clocks differ by ${Math.abs(ppm).toFixed(0)} ppm`;
  find("apart").textContent = `Sound and vibration are ${Math.abs(apart).toFixed(1)} ms apart${clocks}.`;
}

function leave() {
  second.close();
  node?.port.postMessage({ to: null });
  if (delay) delay.delayTime.value = 0;
  dry = 0;
  find("apart").textContent = ONLY_SHOWN;
  tellPower();
}

function tellPower() {
  const on = second.context ? "Vibration is on" : "Vibration is only shown";
  find("power-word").textContent = find("power").getAttribute("aria-checked") === "true" ? on : "Vibration is off";
}

function gone() {
  leave();
  output.value = "";
  say("The output of the vibration has gone. The vibration is only shown until you choose one.", "bad");
}

async function make() {
  if (worker) {
    cancel();
    return say("Cancelled.", "wait");
  }
  const mine = worker = new Worker(new URL("worker.js", import.meta.url), { type: "module" }), name = file.name;
  forget();
  find("progress").hidden = false;
  find("make").textContent = "Cancel";
  say(`The vibration of ${name} is being made.`, "wait");
  try {
    const sound = await wholeSound(file).catch((error) => { find("make").disabled ||= worker === mine; throw error; });
    const needed = await designOf(sound.samplerate);
    if (worker !== mine) return; // cancelled meanwhile
    const { wav, seconds, speed } = await rendered(mine, { ...needed, ...sound });
    vibration.href = URL.createObjectURL(wav);
    vibration.download = `${name.replace(/\.[^.]*$/, "")}-vibration.wav`;
    [vibration.hidden, vibration.dataset.state] = [false, "done"];
    say(`Done: ${seconds.toFixed(1)} s of vibration, made ${speed.toFixed(0)} times faster than it plays. ${sound.note}`.trim());
  } finally {
    if (worker === mine) cancel();
  }
}

function rendered(mine, { wasm, design, samplerate, planes, file }) {
  return new Promise((settle, fail) => {
    mine.onmessage = ({ data }) => {
      if (data.share) find("progress").value = data.share;
      if (data.error) fail(new Error(`The vibration cannot be made: ${data.error}.`));
      if (data.wav) settle(data);
    };
    mine.addEventListener("error", (event) => event.preventDefault());
    mine.onerror = () => fail(new Error("The vibration cannot be made: this browser is too old, or has too little memory."));
    mine.postMessage({ wasm, design, samplerate, planes, file }, planes?.map(({ buffer }) => buffer) ?? []);
  });
}

function cancel() {
  worker?.terminate();
  worker = null;
  [find("progress").hidden, find("progress").value] = [true, 0];
  find("make").textContent = "Make the vibration as a file";
}

function forget() {
  if (vibration.href) URL.revokeObjectURL(vibration.href);
  vibration.removeAttribute("href");
  [vibration.hidden, vibration.dataset.state] = [true, "none"];
}

function begin() {
  followTheme(find("theme"));
  if (!globalThis.WebAssembly) {
    document.querySelectorAll("main button, main select, main input").forEach((one) => { one.disabled = true; });
    return say(NO_WASM, "bad");
  }
  profile.append(...Object.keys(PROFILES).filter((name) => name !== "paper").map((name) => element("option", { value: name }, titled(name))));
  const live = Boolean(globalThis.AudioWorkletNode);
  [find("microphone").hidden, find("screen").hidden] = [!can.microphone || !live, !can.screen || !live];
  [find("screen").textContent, find("screen-note").textContent] = [can.screen, can.note];
  find("route").hidden = !live || !canChoose() || !navigator.mediaDevices;
  if (find("route").hidden) find("apart").textContent = "This browser cannot choose an output. Save the vibration, and play the file on its device.";
  say(live ? "Choose a sound. The vibration is shown here, and is silent until you choose its output." : NO_WORKLET, live ? "good" : "bad");

  find("sound").onchange = asked(({ target }) => target.files[0] && choose(target.files[0]));
  player.onplay = asked(() => { endCapture(); return prepare(); });
  player.onerror = () => file && say(`${file.name} is no sound that this browser can play. Try WAV, MP3, FLAC, Ogg or MP4.`, "bad");
  for (const button of document.querySelectorAll("[data-scene]")) button.onclick = asked(scene);
  for (const button of document.querySelectorAll("[data-capture]")) button.onclick = asked(take);
  find("stop").onclick = () => { endCapture(); say("Choose a sound."); };
  find("make").onclick = asked(make);
  find("find").onclick = asked(findOutputs);
  output.onchange = asked(useOutput);
  profile.onchange = asked(async () => {
    find("profile-meaning").textContent = PROFILES[profile.value];
    if (worker) await make(); // cancels
    forget();
    if (node) await transform();
  });
  const level = () => {
    fill(find("strength"));
    find("strength-value").textContent = `${find("strength").value} dB`;
    second.setGain(strength());
  };
  find("strength").oninput = level;
  find("power").onclick = ({ currentTarget: button }) => {
    button.setAttribute("aria-checked", button.getAttribute("aria-checked") !== "true");
    tellPower();
    level();
  };
  const dragged = (event) => { event.preventDefault(); document.body.dataset.drop = event.type === "dragover"; };
  for (const kind of ["dragover", "dragleave", "drop"]) document.addEventListener(kind, dragged);
  document.ondrop = asked(({ dataTransfer: { files: [dropped] } }) => dropped && choose(dropped));
  navigator.mediaDevices?.addEventListener("devicechange", () => output.length > 1 && list());
  find("profile-meaning").textContent = PROFILES[profile.value];
  level();
  navigator.serviceWorker?.register("offline.js").catch(() => {}); // a browser may forbid it: the page works without
}

begin();
