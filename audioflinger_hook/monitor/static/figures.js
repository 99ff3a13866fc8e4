// Figures of the status: the delay, and panels of rows.

const PERCEIVED_MS = 24;

const element = (kind, text = "", attributes = {}) => {
  const made = document.createElement(kind);
  made.textContent = text;
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  return made;
};
const find = (id) => document.getElementById(id);

const titled = (name) => name[0].toUpperCase() + name.slice(1);

/** figures: [[name, ms, meaning], ...] */
export function showDelay(figures) {
  const total = figures.reduce((sum, [, ms]) => sum + ms, 0), scale = Math.max(32, 1.08 * total, 1.08 * PERCEIVED_MS);
  const parts = figures.map(([name, ms, meaning], index) => ({ name: titled(name), ms, meaning, colour: `var(--part${index + 1})` }))
    .filter((part) => Math.abs(part.ms) >= 0.05);
  const felt = total <= PERCEIVED_MS ? "not perceived" : "may be perceived";
  find("delay").textContent = parts.length ? `${total.toFixed(1)} ms` : "–";
  const bars = parts.filter((part) => part.ms > 0).map((part) => {
    const bar = element("span");
    bar.style.width = `${(100 * part.ms) / scale}%`;
    bar.style.background = part.colour;
    return bar;
  });
  const limit = element("div", "", { class: "limit", "data-label": `${PERCEIVED_MS} ms: longer is perceived` });
  limit.style.left = `${(100 * PERCEIVED_MS) / scale}%`;
  find("budget").replaceChildren(...bars, limit);
  const words = parts.map((part) => `${part.name} ${part.ms.toFixed(1)} ms`).join(", ");
  find("budget").setAttribute("aria-label", parts.length ? `Delay ${total.toFixed(1)} ms, ${felt}: ${words}` : "No delay is known");
  find("parts").replaceChildren(...parts.map((part) => {
    const row = element("li", "", { title: part.meaning }), mark = element("i");
    mark.style.background = part.colour;
    row.append(mark, element("span", part.name), element("span", `${part.ms.toFixed(1)} ms`));
    return row;
  }));
}

/** rows: [[label, text, tone, meaning], ...] */
export function showRows(place, rows) {
  place.replaceChildren(...rows.map(([label, text, tone, meaning]) => {
    const row = element("div", "", { title: meaning });
    row.append(element("dt", titled(label)), element("dd", text, { "data-tone": tone }));
    return row;
  }));
}
