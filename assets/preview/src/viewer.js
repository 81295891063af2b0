// The picture: camera, exposure, drawing when something has changed.

import {
  Color, HalfFloatType, PerspectiveCamera, RGBAFormat, Raycaster, Scene, Spherical, Vector2, Vector3, WebGLRenderer, WebGLRenderTarget,
} from 'three';
import { OrbitControls } from 'three/examples/jsm/controls/OrbitControls.js';
import { VIEWS, common } from './shader.js';

// Where the log-average of a picture is put, and the shares of its pixels that have no say in it and that are white:
// as in the pictures that luxel writes.
const KEY = 0.18;
const TRIM = 0.02;
const WHITE = 0.995;
// Side of the picture that is measured.
const MEASURED = 64;
// Directions in which a level is looked at for walls.
const ROUND = 12;

export class Viewer {
  constructor(canvas) {
    this.renderer = new WebGLRenderer({ canvas, antialias: true, preserveDrawingBuffer: true });
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    this.scene = new Scene();
    this.scene.background = new Color(0x17181a);
    this.camera = new PerspectiveCamera(50, 1, 0.01, 100);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.zoomToCursor = true;
    this.controls.addEventListener('change', () => this.wake());
    canvas.addEventListener('dblclick', (event) => this.orbit(event.clientX, event.clientY));
    this.level = null;
    this.auto = { exposure: 1, white: 4 };
    this.stops = 0;
    this.resize();
    window.addEventListener('resize', () => this.resize());
  }

  resize() {
    const [width, height] = [window.innerWidth, window.innerHeight];
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.wake();
  }

  // Draws before the screen is refreshed next.
  wake() {
    this.frame ??= requestAnimationFrame(() => {
      this.frame = undefined;
      this.draw();
    });
  }

  draw() {
    common.exposure.value = this.auto.exposure * 2 ** this.stops;
    common.white.value = Math.max(1, this.auto.white);
    this.renderer.render(this.scene, this.camera);
  }

  // Shows another level in the place of the last.
  show(level, keepCamera) {
    if (this.level) this.scene.remove(this.level.root);
    this.scene.add(level.root);
    this.level?.dispose();
    this.level = level;
    this.range();
    if (!keepCamera) this.home();
    this.wake();
  }

  clear() {
    if (this.level) this.scene.remove(this.level.root);
    this.level?.dispose();
    this.level = null;
    this.wake();
  }

  range() {
    const size = this.level.bounds.getSize(new Vector3()).length();
    this.camera.near = size / 2000;
    this.camera.far = size * 20;
    this.camera.updateProjectionMatrix();
  }

  // The level's own camera, or one that sees all of it.
  home() {
    const { bounds, camera: own } = this.level;
    const [centre, size] = [bounds.getCenter(new Vector3()), bounds.getSize(new Vector3()).length()];
    if (own) {
      own.getWorldPosition(this.camera.position);
      const ahead = own.getWorldDirection(new Vector3());
      // What is orbited lies ahead, as deep as the level's middle.
      const depth = Math.max(centre.clone().sub(this.camera.position).dot(ahead), size / 10);
      this.controls.target.copy(this.camera.position).addScaledVector(ahead, depth);
      this.camera.fov = own.fov;
    } else if (this.inside(centre)) {
      this.camera.fov = 70;
    } else {
      this.camera.fov = 50;
      const away = new Vector3().setFromSpherical(new Spherical(1, 1.15, 0.6));
      this.camera.position.copy(centre).addScaledVector(away, size / (2 * Math.tan(this.camera.fov * Math.PI / 360)));
      this.controls.target.copy(centre);
    }
    this.camera.updateProjectionMatrix();
    this.controls.update();
  }

  // Takes place about the middle of a level that closes round it, and looks where it is widest. False, and nothing
  // done, in a level that is open to most sides.
  inside(middle) {
    // Symmetric levels have corners in a plane with their very middle. Those would lie beside the camera exactly (at
    // w = 0), where rasterisers in software go wrong.
    const centre = this.level.bounds.getSize(new Vector3()).multiply(new Vector3(0.0117, 0.0071, 0.0093)).add(middle);
    const rays = new Raycaster();
    const look = (direction) => {
      rays.set(centre, direction);
      return rays.intersectObject(this.level.root)[0]?.distance ?? Infinity;
    };
    const towards = (i) => new Vector3().setFromSphericalCoords(1, Math.PI / 2, 2 * Math.PI * (i / ROUND + 0.0031));
    const around = Array.from({ length: ROUND }, (_, i) => towards(i));
    const seen = around.map((direction) => ({ direction, distance: look(direction) }));
    const walls = seen.filter(({ distance }) => distance < Infinity);
    if (walls.length < 0.75 * ROUND) return false;
    const { direction, distance } = walls.reduce((a, b) => (b.distance > a.distance ? b : a));
    this.camera.position.copy(centre);
    this.controls.target.copy(centre).addScaledVector(direction, distance / 4);
    return true;
  }

  // Orbits about the point under the pointer from now on.
  orbit(x, y) {
    const rays = new Raycaster();
    rays.setFromCamera(new Vector2(2 * x / window.innerWidth - 1, 1 - 2 * y / window.innerHeight), this.camera);
    const hit = this.level && rays.intersectObject(this.level.root)[0];
    if (!hit) return;
    this.controls.target.copy(hit.point);
    this.controls.update();
    this.wake();
  }

  set view(name) {
    common.view.value = VIEWS.indexOf(name);
    this.wake();
  }

  get view() {
    return VIEWS[common.view.value];
  }

  // Exposes for what the camera sees, by the radiance of a small picture of it: the log-average comes to middle grey.
  expose() {
    const target = new WebGLRenderTarget(MEASURED, MEASURED, { type: HalfFloatType, format: RGBAFormat });
    const view = common.view.value;
    const background = this.scene.background;
    // Half floats hold x / (1 + x), the curve without white, from 1e-7 to 2000 times the mean.
    const first = 1 / Math.max(common.meanIrradiance.value, 1e-20);
    [common.view.value, common.exposure.value, common.white.value] = [view === 1 ? 1 : 0, first, 1e6];
    this.scene.background = new Color(0);
    this.renderer.setRenderTarget(target);
    this.renderer.render(this.scene, this.camera);
    const halves = new Uint16Array(4 * MEASURED * MEASURED);
    this.renderer.readRenderTargetPixels(target, 0, 0, MEASURED, MEASURED, halves);
    this.renderer.setRenderTarget(null);
    target.dispose();
    this.scene.background = background;
    common.view.value = view;
    const seen = [];
    for (let i = 0; i < halves.length; i += 4) {
      const [r, g, b] = [0, 1, 2].map((band) => fromHalf(halves[i + band]));
      // Back through the curve, x / (1 + x) of the brightest band.
      const most = Math.max(r, g, b);
      if (!(most > 0)) continue;
      const y = (0.2126 * r + 0.7152 * g + 0.0722 * b) / Math.max(1 - most, 5e-4);
      if (y > 0) seen.push(y / first);
    }
    this.auto = exposureOf(seen);
    this.wake();
  }
}

// Exposure for some luminances [cd/m²], and what of them, exposed, is white.
export function exposureOf(seen) {
  if (seen.length === 0) return { exposure: 1, white: 4 };
  const sorted = Float64Array.from(seen).sort();
  const at = (share) => Math.floor((sorted.length - 1) * share);
  const middle = sorted.subarray(at(TRIM), at(1 - TRIM) + 1);
  const mean = middle.reduce((sum, y) => sum + Math.log(y), 0) / middle.length;
  const exposure = KEY / Math.exp(mean);
  return { exposure, white: Math.min(Math.max(sorted[at(WHITE)] * exposure, 1), 1e6) };
}

// A half float as a number.
export function fromHalf(bits) {
  const [sign, exponent, fraction] = [bits >> 15 ? -1 : 1, (bits >> 10) & 31, bits & 1023];
  if (exponent === 0) return sign * fraction * 2 ** -24;
  if (exponent === 31) return fraction ? NaN : sign * Infinity;
  return sign * (1 + fraction / 1024) * 2 ** (exponent - 15);
}
