// The second output: vibration on a device of its own, whose clock is kept beside the clock of the sound.

const FOLLOW_S = 2, PPM_MAX = 5000, JUMP_MS = 5, REST = 20, KEPT = 199, FEW = 40, PAUSED_MS = 8, WATCH_MS = 20, SURE = 600, LONG = 9999, LOOK_MS = 250, ROUTE_MS = 40, MARGIN_S = 0.02;
const DEFAULTS = ["default", "communications", ""]; // never felt by accident: these may be the speakers

export const canChoose = () => "setSinkId" in AudioContext.prototype || "setSinkId" in HTMLMediaElement.prototype;

/** Outputs that may play vibration: [{deviceId, label}], without the one that plays the sound. */
export async function outputs() {
  const found = (await navigator.mediaDevices.enumerateDevices()).filter(({ kind }) => kind === "audiooutput");
  const main = found.find(({ deviceId }) => deviceId === "default")?.label.replace(/^[^-]+- /, "");
  return found.filter(({ deviceId, label }) => !DEFAULTS.includes(deviceId) && label && label !== main);
}

const median = (values) => [...values].sort((one, other) => one - other)[values.length >> 1];

/** The median of the latest values, which are noisy, but change slowly, until a device pauses. */
class Steady {
  latest = [];

  of(value) {
    this.latest = [...this.latest, value].slice(-KEPT);
    const newest = this.latest.slice(-FEW);
    if (Math.abs(median(newest) - median(this.latest)) > PAUSED_MS) this.latest = newest;
    return median(this.latest);
  }
}

/** When an audio context plays its time 0, in ms of the page's clock. Browsers' own output timestamps are too noisy. */
class Clock {
  began = new Steady();
  latency = new Steady();

  of({ currentTime, outputLatency = 0 }) {
    return this.began.of(performance.now() - 1000 * currentTime) + this.latency.of(1000 * outputLatency);
  }
}

/** Keeps one clock beside another: from errors in ms, measured again and again, it finds the rate at which to play. */
export class ClockLock {
  #ppm = 0;
  #count = 0; // of steps since the last jump
  #rest = 0;

  /** error: ms by which the vibration is late. Returns the {rate}, the ms to {jump}, and how much the clocks differ in {ppm}. */
  step(error) {
    if (Math.abs(error) > JUMP_MS && ++this.#rest > REST) {
      this.#rest = this.#count = 0;
      return { rate: 1, jump: error, ppm: 0 };
    }
    const ppm = Math.max(-PPM_MAX, Math.min(PPM_MAX, (1000 * error) / FOLLOW_S));
    this.#count = Math.min(LONG, this.#count + 1);
    this.#ppm += (ppm - this.#ppm) / this.#count;
    return { rate: 1 + 1e-6 * ppm, jump: 0, ppm: this.#count < SURE ? 0 : this.#ppm };
  }
}

export class SecondOutput {
  /** told: called with ({apart, ppm, dry}) while it plays, and with ({gone: true}) when the device has gone. */
  constructor(told) {
    Object.assign(this, { told, gain: 1, context: null });
  }

  /** Open a device. An Error says why it cannot be. sound: AudioContext of the sound. */
  async open(deviceId, sound) {
    this.close();
    const direct = "setSinkId" in AudioContext.prototype, block = sound.baseLatency || 0.01, context = new AudioContext({ latencyHint: block });
    const element = direct ? null : new Audio(), lead = 2 * block + MARGIN_S; // each context may ask for a whole block at once
    try {
      await (element ?? context).setSinkId(deviceId);
      await context.audioWorklet.addModule(new URL("player.js", import.meta.url));
    } catch (error) {
      context.close();
      throw error;
    }
    const node = new AudioWorkletNode(context, "player", { numberOfInputs: 0, outputChannelCount: [1], processorOptions: { samplerate: sound.sampleRate, lead: lead * sound.sampleRate } });
    const level = new GainNode(context, { gain: 0 }), end = direct ? context.destination : new MediaStreamAudioDestinationNode(context);
    node.connect(level).connect(end);
    if (element) [element.srcObject, element.autoplay] = [end.stream, true];
    Object.assign(this, { context, sound, lead, node, level, element, deviceId, lock: new ClockLock(), clocks: [new Clock(), new Clock()], latest: null });
    node.port.onmessage = ({ data }) => { this.latest = data; };
    context.onerror = () => this.told({ gone: true });
    await context.resume();
    this.setGain(this.gain);
    this.timers = [setInterval(() => this.watch(), WATCH_MS), setInterval(() => this.look(), LOOK_MS)];
  }

  /** The port that takes vibration. */
  port() {
    const { port1, port2 } = new MessageChannel();
    this.node.port.postMessage({ from: port2 }, [port2]);
    return port1;
  }

  setGain(gain) {
    this.gain = gain;
    this.level?.gain.setTargetAtTime(gain, this.context.currentTime, 0.02);
  }

  /** s by which the sound must be held back, so that the vibration can come with it. */
  wanted(latency) {
    const ahead = (this.context.outputLatency || 0) - (this.sound.outputLatency || 0);
    return Math.max(0, latency + this.lead + MARGIN_S + ahead + (this.element ? ROUTE_MS / 1000 : 0));
  }

  watch() {
    const latest = this.latest, [felt, heard] = [this.context, this.sound].map((context, which) => this.clocks[which].of(context));
    if (!latest) return;
    this.latest = null;
    // delay: s by which the sound is held back; latency: s of the transform
    const position = latest.position / this.sound.sampleRate - this.latency + this.delay;
    const apart = felt + 1000 * latest.time + (this.element ? ROUTE_MS : 0) - (heard + 1000 * position);
    const { rate, jump, ppm } = this.lock.step(apart);
    this.node.port.postMessage({ step: rate, jump: (jump / 1000) * this.sound.sampleRate });
    this.told({ apart, ppm, dry: latest.dry });
  }

  /** Look for the device: browsers do not tell of each that goes. */
  async look() {
    const found = await outputs();
    if (this.deviceId && !found.some(({ deviceId }) => deviceId === this.deviceId)) this.told({ gone: true });
  }

  close() {
    this.timers?.forEach(clearInterval);
    this.element?.pause();
    this.context?.close();
    Object.assign(this, { context: null, level: null, element: null, deviceId: "" });
  }
}
