// Plays vibration on another clock: a buffer between two audio contexts, read at a rate that the page sets.

const ROOM = 1 << 16, TOLD_FRAMES = 2048;

class Player extends AudioWorkletProcessor {
  constructor({ processorOptions: { samplerate, lead } }) {
    super();
    // position: of the next output frame, in frames of the sound's context
    Object.assign(this, { ring: new Float32Array(ROOM), lead, written: 0, position: 0, waits: true, told: 0, dry: 0 });
    this.nominal = this.step = samplerate / sampleRate;
    this.port.onmessage = ({ data: { from, step, jump } }) => {
      if (from) from.onmessage = ({ data }) => this.take(data);
      if (step) this.step = this.nominal * step;
      if (jump) this.position += jump;
    };
  }

  take({ frame, samples }) {
    if (frame !== this.written) [this.waits, this.position] = [true, frame]; // a new stream
    for (let at = 0; at < samples.length; at++) this.ring[(frame + at) % ROOM] = samples[at];
    this.written = frame + samples.length;
  }

  process(_, [[output]]) {
    if (this.waits && this.written - this.position >= this.lead) this.waits = false;
    this.position = Math.max(this.position, this.written - ROOM / 2);
    for (let at = 0; at < output.length; at++) {
      const first = Math.floor(this.position), share = this.position - first;
      if (!this.waits && first + 1 >= this.written) [this.waits, this.dry] = [true, this.dry + 1];
      if (this.waits) continue; // output holds zeros
      output[at] = (1 - share) * this.ring[first % ROOM] + share * this.ring[(first + 1) % ROOM];
      this.position += this.step;
    }
    this.told += output.length;
    if (this.told >= TOLD_FRAMES && !this.waits) {
      this.told = 0;
      this.port.postMessage({ position: this.position, time: currentTime + output.length / sampleRate, dry: this.dry });
    }
    return true;
  }
}

registerProcessor("player", Player);
