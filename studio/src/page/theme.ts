// Light or dark: as the machine says, unless somebody chose; and whether motion is to be reduced.

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

/** Put the theme on the page; call `onChange` when it changes. */
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
    // A page without storage forgets the choice, and still makes it.
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
