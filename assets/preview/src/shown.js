// A scene on show follows the scene on disk, fetching no more than what is new.

import { Level } from './level.js';
import { lightmapOf } from './lightmap.js';
import { Overtaken, bytes } from './feed.js';

export class Shown {
  // `viewer` draws; `onShown` is told after something new is on show.
  constructor(viewer, onShown) {
    Object.assign(this, { viewer, onShown, wanted: null, busy: false });
    this.pages = new Map();
    // The scene on show, by its path: numbers begin anew with the server. And what of it is on show.
    this.path = null;
    this.now = null;
    this.fromBytes = false;
  }

  // The scene as the server tells it. Another one than before starts afresh.
  async follow(scene) {
    this.wanted = scene;
    if (this.busy) return;
    this.busy = true;
    try {
      // What comes in meanwhile is followed in turn; of several, only the last.
      while (this.wanted) {
        const next = this.wanted;
        this.wanted = null;
        await this.update(next);
      }
    } finally {
      this.busy = false;
    }
  }

  async update(scene) {
    const { outputs } = scene;
    const isOther = this.path !== scene.path;
    if (isOther) this.now = null;
    if (!outputs?.glb) {
      // Another scene's level under this one's name would be a lie.
      if (isOther) this.clear();
      return this.onShown(scene, null);
    }
    const same = (what) => this.now !== null && outputs[what] !== null && this.now[what] === outputs[what];
    try {
      const pages = await this.fetchPages(outputs.lightmaps);
      // New light fits what is on show: there it is, whatever else is still to come.
      if (same('layout')) this.swap(scene, pages, null);
      // The pictures within the .glb are others with every light, and on show only when they are asked for.
      const isLoaded = this.now !== null && this.now.glb === outputs.glb;
      if (!isLoaded && !(same('content') && !this.fromBytes)) {
        const level = await Level.parse(await bytes(outputs.glb));
        this.swap(scene, pages, level, isOther);
        this.now.glb = outputs.glb;
      }
      this.now.content = outputs.content;
    } catch (error) {
      if (!(error instanceof Overtaken)) throw error;
      // As a rule the next event is on its way. Until then, and for ever where somebody else has changed the files:
      if (!this.wanted) throw new Error('its files are being replaced, or are not those that its report lists');
    }
  }

  // Pages by their numbers. An address names content, so one that is the same need not be fetched again.
  async fetchPages(lightmaps) {
    const fetched = lightmaps.map(async ({ page, texels }) => {
      const old = this.pages.get(page);
      return [page, old?.address === texels ? old : { ...lightmapOf(await bytes(texels)), address: texels }];
    });
    return new Map(await Promise.all(fetched));
  }

  swap(scene, pages, level, isOther = false) {
    const old = this.pages;
    this.pages = pages;
    (level ?? this.viewer.level).light(pages, this.fromBytes);
    this.onShown(scene, level, isOther);
    if (level) {
      this.viewer.show(level, !isOther);
      this.now = { glb: null, content: null };
      this.path = scene.path;
    }
    this.now.layout = scene.outputs.layout;
    for (const [number, page] of old) if (pages.get(number) !== page) page.texture.dispose();
    this.viewer.draw();
    this.onDrawn?.(scene, level !== null, isOther);
  }

  // Shows nothing.
  clear() {
    this.viewer.clear();
    this.pages.forEach((page) => page.texture.dispose());
    this.pages.clear();
    this.path = null;
  }

  // Light from the pictures within the .glb, or from the .exr.
  async setBytes(on, scene) {
    this.fromBytes = on;
    this.viewer.level?.light(this.pages, on);
    this.viewer.wake();
    // The pictures on show may be those of an earlier light.
    if (on && scene) await this.follow(scene);
  }
}
