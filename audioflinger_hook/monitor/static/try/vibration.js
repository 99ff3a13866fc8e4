// The core in the audio thread: sound of two channels in, vibration out, and what the panels show.

import { Core } from "./core.js";

const TOLD_PER_S = 30, SENT_FRAMES = 256;

class Vibration extends AudioWorkletProcessor {
  constructor({ processorOptions: { wasm, design } }) {
    super();
    this.core = new Core(wasm, design, 2);
    this.told = this.filled = 0;
    this.sent = new Float32Array(SENT_FRAMES);
    this.port.onmessage = ({ data }) => Object.assign(this, data); // `to`: port of a Player or null; `ends`
    this.port.postMessage({ latency: this.core.latency / sampleRate });
  }

  process([input], [[output]]) {
    const count = output.length;
    this.core.inputs.forEach((to, channel) => (input[channel] ? to.set(input[channel]) : to.fill(0, 0, count)));
    output.set(this.core.process(count, true));
    if (this.to) this.send(output);
    this.told += count;
    if (this.told >= sampleRate / TOLD_PER_S) {
      this.told = 0;
      this.port.postMessage(this.core.read());
    }
    return !this.ends;
  }

  /** Send vibration to the other output. frame: of the audio context, the first that is sent. */
  send(vibration) {
    this.sent.set(vibration, this.filled);
    this.filled += vibration.length;
    if (this.filled < SENT_FRAMES) return;
    this.to.postMessage({ frame: currentFrame + vibration.length - SENT_FRAMES, samples: this.sent });
    this.filled = 0;
  }
}

registerProcessor("vibration", Vibration);
