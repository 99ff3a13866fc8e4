// The button for dark colours, light colours, or those of the system.

const THEMES = ["system", "dark", "light"];

export function followTheme(button) {
  const systemLight = matchMedia("(prefers-color-scheme: light)");
  const show = (step) => {
    const chosen = THEMES[(THEMES.indexOf(localStorage.getItem("theme") ?? "system") + step) % THEMES.length];
    if (step) localStorage.setItem("theme", chosen);
    document.documentElement.dataset.theme = chosen === "system" ? (systemLight.matches ? "light" : "dark") : chosen;
    button.textContent = button.ariaLabel = `Colours: ${chosen}`;
  };
  systemLight.onchange = () => show(0);
  button.onclick = () => show(1);
  show(0);
}
