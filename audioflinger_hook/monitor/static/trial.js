// The answering page: a trial of jsPsych for each screen of the session, whose program plays and decides.

import { Connection } from "/connection.js";
import { element, fill, find } from "/elements.js";

const GONE = "The program of the session does not answer. All answers are kept; run its command again.";
const WAITING = { number: 0, kind: "playing", title: "One moment", text: [], choices: [], also: [], labels: [], done: 0, total: 0 };
const light = matchMedia("(prefers-color-scheme: light)");
const state = { screen: WAITING, drawn: null, paused: false, pauses: 0, pausedMs: 0, pausedAt: 0, ended: false, stopped: false, buttons: [], held: -1 };
const connection = new Connection((kind, content) => {
  if (kind === "trial") take(content);
  else if (kind === "link") notice(state.ended ? "" : GONE);
});

function notice(text) {
  find("notice").textContent = text;
  find("notice").hidden = !text;
}

/** Show what the session's program sends: another screen, or the same one with a pause begun or ended. */
function take(screen) {
  if (state.stopped) return;
  notice("");
  if (screen.paused !== state.paused) pause(screen.paused);
  if (screen.number === state.screen.number) return;
  state.screen = screen;
  state.ended = screen.kind === "text" && !screen.choices.length;
  if (state.drawn) jsPsych.finishTrial({ number: state.drawn.number });
}

function pause(paused) {
  state.paused = paused;
  state.pauses += paused;
  if (paused) state.pausedAt = performance.now();
  else state.pausedMs += performance.now() - state.pausedAt;
  if (paused && !state.ended) find("paused").showModal();
  else find("paused").close();
}

/** A plugin of jsPsych that shows one screen; it ends when the session's program sends the next. */
class Screen {
  static info = { name: "screen", version: "1", parameters: { screen: { type: jsPsychModule.ParameterType.OBJECT } }, data: { number: { type: jsPsychModule.ParameterType.INT } } };

  constructor(jsPsych) {
    this.api = jsPsych.pluginAPI;
  }

  trial(display, { screen }) {
    Object.assign(this, { screen, answered: false });
    Object.assign(state, { drawn: screen, pauses: 0, pausedMs: 0, pausedAt: performance.now() });
    this.api.cancelAllKeyboardResponses();
    showHead(screen);
    const title = element("h1", { tabindex: "-1" }, screen.title);
    state.buttons = this.buttons = [];
    display.replaceChildren(
      ...(screen.practice ? [element("strong", { class: "practice" }, "Practice")] : []),
      title,
      ...screen.text.map((paragraph) => element("p", {}, paragraph)),
      ...(screen.kind === "slider" ? this.slider(screen) : []),
      ...this.row(screen.choices, `choices ${screen.kind.replace(" ", "-")}`),
      ...this.row(screen.also, "also"),
    );
    const keys = new Map([...screen.choices, ...screen.also].filter(([, , key]) => key).map(([value, , key]) => [key, value]));
    if (keys.size) {
      const callback_function = ({ key }) => this.answer(keys.get(key));
      this.api.getKeyboardResponse({ callback_function, valid_responses: [...keys.keys()], persist: true, allow_held_key: false });
    }
    title.focus(); // keys work, and a screen reader reads the question
    this.beganAt = performance.now();
    if (screen.number !== state.screen.number) jsPsych.finishTrial({ number: screen.number }); // another one came meanwhile
  }

  slider({ labels, title }) {
    const input = element("input", { type: "range", min: 0, max: 100, step: 1, value: 50, "aria-label": title, "data-unset": "true" });
    const shown = element("output", {}, "Move the slider");
    const next = this.button("Next", "", () => this.answer(Number(input.value)));
    next.disabled = true; // nobody answers with where the slider stands at first
    next.className = "primary next";
    input.oninput = () => {
      fill(input);
      shown.textContent = input.value;
      input.removeAttribute("data-unset");
      next.disabled = this.answered;
    };
    input.onkeydown = ({ key }) => {
      if (key === "Enter") next.click();
    };
    return [element("div", { class: "rating" }, shown, input, element("p", { class: "ends" }, ...labels.map((one) => element("span", {}, one)))), next];
  }

  row(choices, kind) {
    const made = choices.map(([value, label, key]) => this.button(label, key, () => this.answer(value)));
    return made.length ? [element("div", { class: kind }, ...made)] : [];
  }

  button(label, key, onclick) {
    const made = element("button", { type: "button" }, element("span", {}, label), ...(key ? [element("kbd", {}, key.toUpperCase())] : []));
    made.onclick = onclick;
    this.buttons.push(made);
    return made;
  }

  async answer(value) {
    if (this.answered || state.paused) return;
    this.answered = true;
    const after_s = (performance.now() - this.beganAt - state.pausedMs) / 1e3;
    for (const button of this.buttons) button.disabled = true;
    const { error } = await connection.ask({ number: this.screen.number, value, after_s, pauses: state.pauses });
    if (!error) return;
    notice(error);
    this.answered = false;
    for (const button of this.buttons) button.disabled = false;
  }
}

/** A controller's buttons press those of the screen in their order; a held button counts once. */
function readControllers() {
  const pressed = navigator.getGamepads().flatMap((one) => (one ? [one.buttons.findIndex((button) => button.pressed)] : []));
  const index = Math.max(-1, ...pressed);
  if (index !== state.held) state.buttons[index]?.click();
  state.held = index;
  requestAnimationFrame(readControllers);
}

function showHead({ kind, done, total, choices }) {
  find("progress").hidden = !total;
  Object.assign(find("bar-done"), { max: total || 1, value: done });
  find("counts").textContent = `${done} of ${total}`;
  const over = kind === "text" && !choices.length;
  find("pause").hidden = find("stop").hidden = over;
}

async function tell(request) {
  const { error = "" } = await connection.ask(request);
  notice(error);
}

find("pause").onclick = find("stop").onclick = () => tell({ paused: true });
find("go-on").onclick = () => tell({ paused: false });
find("paused").oncancel = (event) => {
  event.preventDefault();
  tell({ paused: false });
};
find("end").onclick = async () => {
  state.ended = true;
  await tell({ stopped: true });
  take({ ...WAITING, kind: "text", number: -1, title: "The session has ended", text: ["All answers are kept. You can close this page."], paused: false });
  state.stopped = true;
};
const showTheme = () => { document.documentElement.dataset.theme = light.matches ? "light" : "dark"; };
light.onchange = showTheme;
addEventListener("gamepadconnected", readControllers, { once: true });
showTheme();
connection.open();
const jsPsych = jsPsychModule.initJsPsych({ display_element: "screen" });
jsPsych.run([{ timeline: [{ type: Screen, screen: () => state.screen }], loop_function: () => true }]);
