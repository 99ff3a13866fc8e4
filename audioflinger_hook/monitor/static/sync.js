// The sync test: clicks of the browser are heard and felt, and a person moves the vibration until both agree.

import { fill, find, newest } from "./elements.js";

const EVERY_MS = 1400, CLICK_S = 0.012, CLICK_HZ = 1000;
const FIRST_STEP_MS = 80, LAST_STEP_MS = 5;

/** The next offset after an answer: steps halve whenever the direction turns. All times in ms. */
export function stepped({ offset, step, before }, direction, longest) {
  const turned = before && before !== direction, next = turned ? Math.max(LAST_STEP_MS, step / 2) : step;
  return { offset: Math.min(longest, Math.max(0, Math.round(offset + direction * next))), step: next, before: direction };
}

export class SyncTest {
  /** ask: sends a request to the daemon. stored: called when a delay has been stored. */
  constructor(ask, stored) {
    this.ask = ask;
    this.stored = stored;
    this.dialog = find("sync-dialog");
    this.slider = find("sync-ms");
    this.play = newest(async (ms) => this.tell(await ask({ sync: { try_ms: ms } }))); // null ends the trial
    const answer = (direction) => this.try(stepped(this.state, direction, Number(this.slider.max)));
    find("sync-felt").onclick = () => answer(1);
    find("sync-heard").onclick = () => answer(-1);
    find("sync-both").onclick = () => this.store();
    find("sync-cancel").onclick = () => this.dialog.close();
    this.slider.oninput = () => this.try({ ...this.state, offset: Number(this.slider.value) });
    this.dialog.onclose = () => this.end();
    addEventListener("pagehide", () => this.dialog.close());
  }

  /** offset: delay in ms that is played first. */
  begin(offset) {
    this.sound = new AudioContext();
    this.dialog.showModal();
    this.try({ offset: Math.round(Math.max(0, offset)), step: FIRST_STEP_MS, before: 0 });
    this.timer = setInterval(() => this.click(), EVERY_MS);
  }

  click() {
    const at = this.sound.currentTime + 0.02, tone = this.sound.createOscillator(), gain = this.sound.createGain();
    tone.frequency.value = CLICK_HZ;
    gain.gain.setValueAtTime(0.8, at);
    gain.gain.exponentialRampToValueAtTime(0.001, at + CLICK_S);
    tone.connect(gain).connect(this.sound.destination);
    tone.start(at);
    tone.stop(at + CLICK_S);
    this.play(this.state.offset); // a trial that is not repeated ends
  }

  try(state) {
    this.state = state;
    this.slider.value = state.offset;
    fill(this.slider);
    find("sync-value").textContent = `${state.offset} ms`;
    this.play(state.offset);
  }

  async store() {
    const answer = await this.ask({ sync: { store_ms: this.state.offset } });
    this.tell(answer);
    if (answer.error) return;
    this.dialog.close();
    this.stored();
  }

  tell({ error = "" }) {
    find("sync-error").textContent = error;
  }

  end() {
    clearInterval(this.timer);
    this.sound.close();
    this.play(null);
  }
}
