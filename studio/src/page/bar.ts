// The bar at the top: the systems, the camera, light or dark, help.

import type { CameraMode } from "../scene/cameras";
import { button, element } from "./dom";

const CAMERA_NAMES: Record<CameraMode, string> = { follow: "Follow", chase: "Chase", orbit: "Stay" };

export interface BarActions {
  nextCamera(): void;
  toggleTheme(): void;
  help(): void;
}

export interface Bar {
  readonly element: HTMLElement;
  showCamera(mode: CameraMode): void;
}

/** Return the bar with the `picker` of systems in it. */
export function makeBar(picker: HTMLElement, actions: BarActions): Bar {
  const brand = element("div", "brand", ["NeuroAnimator ", element("span", "", ["Studio"])]);
  const camera = button({ label: CAMERA_NAMES.follow, title: "Camera: follow, chase, stay (C)", onClick: () => actions.nextCamera() });
  const theme = button({ label: "◐", title: "Light or dark", onClick: () => actions.toggleTheme() });
  const help = button({ label: "?", title: "Help (?)", onClick: () => actions.help() });
  const side = button({ label: "☰", title: "Panels", className: "side-toggle", onClick: () => document.body.classList.toggle("with-side") });
  // A portrait window has room for the panels below the stage.
  document.body.classList.toggle("with-side", matchMedia("(orientation: portrait)").matches);
  const tools = element("div", "tools", [camera, theme, help, side]);
  return {
    element: element("header", "bar", [brand, picker, tools]),
    showCamera: (mode) => (camera.textContent = CAMERA_NAMES[mode]),
  };
}
