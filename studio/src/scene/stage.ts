// The renderer, the sun and its shadow, tone mapping, and the resolution on a slow machine.

import {
  Color,
  DirectionalLight,
  HemisphereLight,
  NeutralToneMapping,
  PCFShadowMap,
  PerspectiveCamera,
  PMREMGenerator,
  Scene,
  Vector3,
  WebGLRenderer,
  type Object3D,
} from "three";
import { physicsRoot } from "./axes";
import { disposeOf } from "./dispose";
import { detail } from "./glsl";

/** Vertical angle of view [deg]: that of a 50 mm lens. */
const FIELD_OF_VIEW = 40;

/** Side of the shadow map [texels]. */
const SHADOW_SIZE = 2048;
const SMALL_SHADOW_SIZE = 1024;

/** Light from above and below instead of a mirrored sky, over its intensity. */
const FILL = 2;

/** Resolutions over that of the screen, the finest first. */
const FINENESS = [1, 0.8, 0.65, 0.5, 0.35];

/** Mean time of an image above which the picture becomes coarser, and below which it becomes finer [s]. */
const SLOW_IMAGE = 1 / 28;
const QUICK_IMAGE = 1 / 55;

/** Number of images measured before the resolution changes. */
const IMAGES_BETWEEN_CHANGES = 40;

/** The same for images of at least this time [s]: a stuttering picture is worse than a coarse one. */
const FEW_IMAGES = 6;
const VERY_SLOW_IMAGE = 0.12;

/** Index of the resolution from which on shadows and caustics are redrawn only now and then. */
const COARSE = 3;

/** Light, air and shadows of a scene. */
export interface Atmosphere {
  /** Where the sun stands, in three.js' axes. */
  readonly sunDirection: Vector3;
  readonly sunColour: Color;
  readonly sunIntensity: number;
  /** Softness of shadows. */
  readonly shadowRadius: number;
  readonly environmentIntensity: number;
  readonly exposure: number;
}

/** Width and height of a picture [pixels]. */
export interface PictureSize {
  readonly width: number;
  readonly height: number;
}

export class Stage {
  readonly scene = new Scene();
  readonly root: Object3D = physicsRoot();
  readonly camera = new PerspectiveCamera(FIELD_OF_VIEW, 1, 0.01, 500);
  readonly sun = new DirectionalLight();
  readonly renderer: WebGLRenderer;

  /** Half the width of the shadowed area [m]. */
  #shadowReach = 1;
  #sunDirection = new Vector3(0, 1, 0);
  readonly #isSoftware: boolean;
  readonly #isFixed: boolean;
  readonly #shadowSize: number;
  readonly #fill = new HemisphereLight(0xdcefff, 0x8a7f6c);
  #filmSize: PictureSize | null = null;
  #fineness: number;
  #imageTime = 1 / 60;
  #images = 0;

  /** Throws an Error without WebGL. `isFine` draws everything, however slowly, for pictures to keep. */
  constructor(
    readonly canvas: HTMLCanvasElement,
    isFine = false,
  ) {
    this.#isSoftware = !isFine && isSoftware();
    this.#isFixed = isFine;
    detail.isCoarse = this.#isSoftware;
    this.renderer = new WebGLRenderer({
      canvas,
      antialias: !this.#isSoftware,
      powerPreference: "high-performance",
    });
    this.renderer.toneMapping = NeutralToneMapping;
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = PCFShadowMap;
    this.#fineness = this.#isSoftware ? COARSE : 0;
    this.sun.castShadow = true;
    this.#shadowSize = this.#isSoftware ? SMALL_SHADOW_SIZE : SHADOW_SIZE;
    this.sun.shadow.mapSize.set(this.#shadowSize, this.#shadowSize);
    this.scene.add(this.root, this.sun, this.sun.target);
    this.resize();
  }

  /** Light the scene. `reach` is half the width of the shadowed area [m]. */
  light(atmosphere: Atmosphere, reach: number): void {
    this.#sunDirection.copy(atmosphere.sunDirection).normalize();
    this.#shadowReach = reach;
    this.sun.color.copy(atmosphere.sunColour);
    this.sun.intensity = atmosphere.sunIntensity;
    this.sun.shadow.radius = atmosphere.shadowRadius;
    this.sun.shadow.normalBias = (2 * reach) / this.#shadowSize;
    this.sun.shadow.bias = -0.0004;
    const shadowCamera = this.sun.shadow.camera;
    shadowCamera.left = shadowCamera.bottom = -reach;
    shadowCamera.right = shadowCamera.top = reach;
    shadowCamera.near = 0;
    shadowCamera.far = 8 * reach;
    shadowCamera.updateProjectionMatrix();
    this.scene.environmentIntensity = atmosphere.environmentIntensity;
    this.#fill.intensity = FILL * atmosphere.environmentIntensity;
    this.renderer.toneMappingExposure = atmosphere.exposure;
  }

  /** Set the reflections: `sky` is drawn once, all around, and then discarded. */
  reflect(sky: Scene): void {
    this.#mirror(sky);
    sky.traverse(disposeOf);
  }

  #mirror(sky: Scene): void {
    if (this.#isSoftware) {
      // Without a graphics card a mirrored sky takes seconds; light from above and below must do.
      this.scene.add(this.#fill);
      return;
    }
    const generator = new PMREMGenerator(this.renderer);
    const target = generator.fromScene(sky);
    generator.dispose();
    this.scene.environment?.dispose();
    this.scene.environment = target.texture;
  }

  /** Let the sun follow the look-at point, in steps of the shadow map's texels, so that edges do not swim. */
  follow(focus: Vector3): void {
    const grain = (2 * this.#shadowReach) / this.#shadowSize;
    const snapped = focus.clone().divideScalar(grain * 8).round().multiplyScalar(grain * 8);
    this.sun.target.position.copy(snapped);
    this.sun.position.copy(snapped).addScaledVector(this.#sunDirection, 4 * this.#shadowReach);
  }

  /** Draw an image, `seconds` after the one before. */
  draw(seconds: number): void {
    this.renderer.shadowMap.autoUpdate = !this.isSlow || this.#images % 2 === 0;
    this.renderer.render(this.scene, this.camera);
    if (!this.#filmSize) {
      this.#adapt(seconds);
    }
  }

  /** Whether the machine is too slow to redraw everything in every image. */
  get isSlow(): boolean {
    return !this.#filmSize && this.#fineness >= COARSE;
  }

  /** Size of a film's pictures while one is made, drawn at full detail however long it takes; else null. */
  set filmSize(size: PictureSize | null) {
    this.#filmSize = size;
    this.resize();
  }

  /** Fit the picture to its space on the page, or to the film. */
  resize(): void {
    const width = this.#filmSize?.width ?? Math.max(this.canvas.clientWidth, 1);
    const height = this.#filmSize?.height ?? Math.max(this.canvas.clientHeight, 1);
    const ratio = this.#filmSize ? 1 : Math.min(window.devicePixelRatio, 2) * FINENESS[this.#fineness]!;
    this.renderer.setPixelRatio(ratio);
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
  }

  dispose(): void {
    this.renderer.dispose();
  }

  // The picture becomes coarser on a machine that cannot keep up, and finer again when there is time.
  #adapt(seconds: number): void {
    this.#imageTime += 0.1 * (Math.min(seconds, 0.5) - this.#imageTime);
    this.#images += 1;
    const wait = this.#imageTime > VERY_SLOW_IMAGE ? FEW_IMAGES : IMAGES_BETWEEN_CHANGES;
    if (this.#isFixed || this.#images < wait) {
      return;
    }
    this.#images = 0;
    const coarsest = FINENESS.length - 1;
    if (this.#imageTime > SLOW_IMAGE && this.#fineness < coarsest) {
      this.#fineness += 1;
      this.resize();
    } else if (this.#imageTime < QUICK_IMAGE && this.#fineness > 0) {
      this.#fineness -= 1;
      this.resize();
    }
  }
}

/** Whether the processor draws, without a graphics card. */
function isSoftware(): boolean {
  const context = document.createElement("canvas").getContext("webgl2");
  const extension = context?.getExtension("WEBGL_debug_renderer_info");
  const name = extension ? String(context!.getParameter(extension.UNMASKED_RENDERER_WEBGL)) : "";
  context?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software|basic render/i.test(name);
}
