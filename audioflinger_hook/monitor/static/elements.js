// What the modules share to build the page: elements, words, sliders.

export const find = (id) => document.getElementById(id);
export const titled = (word) => `${word}`[0].toUpperCase() + `${word}`.slice(1);

/** What each profile is for. */
export const PROFILES = {
  cinema: "for films and series", game: "earlier, for games", music: "bass and rhythm", speech: "the syllables of voices",
  paper: "the published method, unchanged",
};

/** content: text and elements. */
export function element(kind, attributes = {}, ...content) {
  const made = document.createElement(kind);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...content);
  return made;
}

/** Colour a slider's track up to its thumb. */
export function fill({ value, min, max, style }) {
  style.setProperty("--fill", `${(100 * (value - min)) / (max - min)}%`);
}

/** Send one value at a time; while one is under way, only the newest waits. Its `busy` tells whether one is. */
export function newest(send) {
  let waiting = [];
  const put = async (value) => {
    waiting = [value];
    if (put.busy) return;
    put.busy = true;
    while (waiting.length) await send(waiting.pop());
    put.busy = false;
  };
  return put;
}
