// Figures of the status: the delay, and panels of rows.

import { element, find, titled } from "./elements.js";

const PERCEIVED_MS = 24;

/** figures: [[name, ms, meaning], ...] */
export function showDelay(figures) {
  const total = figures.reduce((sum, [, ms]) => sum + ms, 0), scale = Math.max(32, 1.08 * total);
  const parts = figures.map(([name, ms, meaning], index) => ({ name: titled(name), ms, meaning, colour: `var(--part${index + 1})` }))
    .filter((part) => Math.abs(part.ms) >= 0.05);
  const painted = (made, part, width) => {
    made.style.background = part.colour;
    if (width) made.style.width = width;
    return made;
  };
  const share = (ms) => `${(100 * ms) / scale}%`;
  const limit = element("div", { class: "limit", "data-label": `${PERCEIVED_MS} ms: longer is perceived` });
  limit.style.left = share(PERCEIVED_MS);
  find("delay").textContent = parts.length ? `${total.toFixed(1)} ms` : "–";
  const bars = parts.filter((part) => part.ms > 0).map((part) => painted(element("span"), part, share(part.ms)));
  find("budget").replaceChildren(...bars, limit);
  const felt = total <= PERCEIVED_MS ? "not perceived" : "may be perceived";
  const words = parts.map((part) => `${part.name} ${part.ms.toFixed(1)} ms`).join(", ");
  find("budget").setAttribute("aria-label", parts.length ? `Delay ${total.toFixed(1)} ms, ${felt}: ${words}` : "No delay is known");
  find("parts").replaceChildren(...parts.map((part) => element("li", { title: part.meaning },
    painted(element("i"), part), element("span", {}, part.name), element("span", {}, `${part.ms.toFixed(1)} ms`))));
}

/** rows: [[label, text, tone, meaning], ...] */
export function showRows(place, rows) {
  place.replaceChildren(...rows.map(([label, text, tone, meaning]) => element("div", { title: meaning },
    element("dt", {}, titled(label)), element("dd", { "data-tone": tone }, text))));
}
