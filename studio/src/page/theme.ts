// Light or dark: as the system prefers, unless the user has chosen; and whether to reduce motion.

const KEY = "neuroanimator-theme";

const prefersDark = matchMedia("(prefers-color-scheme: dark)");
const prefersLessMotion = matchMedia("(prefers-reduced-motion: reduce)");

export function isDark(): boolean {
  const chosen = stored();
  return chosen ? chosen === "dark" : prefersDark.matches;
}

export function isMotionReduced(): boolean {
  return prefersLessMotion.matches;
}

/** Apply the theme to the page; call `onChange` when it changes. */
export function followTheme(onChange: () => void): void {
  apply();
  prefersDark.addEventListener("change", () => {
    apply();
    onChange();
  });
}

/** Change from light to dark or back, and remember it. */
export function toggleTheme(): void {
  try {
    localStorage.setItem(KEY, isDark() ? "light" : "dark");
  } catch {
    // A page without storage forgets the choice, but still applies it.
  }
  apply(document.documentElement.dataset["theme"] === "dark" ? "light" : "dark");
}

function apply(theme = isDark() ? "dark" : "light"): void {
  document.documentElement.dataset["theme"] = theme;
}

function stored(): string | null {
  try {
    return localStorage.getItem(KEY);
  } catch {
    return null;
  }
}
