// A scene on show follows the scene on disk, fetching no more than what is new.

import { Level } from './level.js';
import { lightmapOf } from './lightmap.js';
import { Overtaken, TooLarge, bytes } from './feed.js';

const PARTS = { bytes, lightmapOf, parse: (buffer) => Level.parse(buffer) };

export class Shown {
  // `viewer` draws; `onShown` is told before something new is drawn. `parts` fetch and read what is shown.
  constructor(viewer, onShown, parts = PARTS) {
    Object.assign(this, { viewer, onShown, parts, wanted: null, busy: false });
    this.pages = new Map();
    // Pages that were asked for, by their addresses.
    this.coming = new Map();
    // The scene on show, by its path: numbers begin anew with the server. And what of it is on show.
    this.path = null;
    this.now = null;
    this.fromBytes = false;
    // Pages that are too large to be sent as they are, and are shown by the pictures of the .glb.
    this.tooLarge = [];
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
        try {
          await this.update(next);
        } catch (error) {
          // Another scene's level under this one's name would be a lie.
          if (this.path !== next.path) this.clear();
          // What is wrong with a scene is nobody's business once another one, or a newer one, is wanted.
          if (!this.wanted) throw error;
        }
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
      // Another scene's level under this one's name would be a lie; so would that of a scene that has gone.
      if (isOther || scene.status?.state === 'removed') this.clear();
      return this.onShown(scene, null);
    }
    // Whether the new light fits what is on show will be told in a moment; the light is fetched meanwhile.
    if (outputs.pending && this.now !== null) return this.ask(outputs.lightmaps);
    const same = (what) => this.now !== null && outputs[what] !== null && this.now[what] === outputs[what];
    try {
      const pages = await this.fetchPages(outputs.lightmaps);
      // New light fits what is on show: there it is, whatever else is still to come.
      const isWhole = this.tooLarge.length === 0;
      if (same('layout') && isWhole) this.swap(scene, pages, null);
      // The pictures within the .glb are others with every light, and on show only when they are asked for.
      const isLoaded = this.now !== null && this.now.glb === outputs.glb;
      if (!isLoaded && !(same('content') && !this.fromBytes && isWhole)) {
        const level = await this.parts.parse(await this.parts.bytes(outputs.glb));
        this.swap(scene, pages, level, isOther);
        this.now.glb = outputs.glb;
      }
      this.now.layout = outputs.layout;
      this.now.content = outputs.content;
    } catch (error) {
      if (!(error instanceof Overtaken)) throw error;
      // As a rule the next event is on its way. Until then, and for ever where somebody else has changed the files:
      throw new Error('its files are being replaced, or are not those that its report lists');
    }
  }

  // Asks for the pages that are not there yet. An address names content, so one that is the same need not be fetched
  // again.
  ask(lightmaps) {
    const wanted = new Set(lightmaps.map(({ texels }) => texels));
    for (const address of this.coming.keys()) if (!wanted.has(address)) this.coming.delete(address);
    for (const { page, texels } of lightmaps) {
      if (this.pages.get(page)?.address === texels || this.coming.has(texels)) continue;
      const coming = this.parts.bytes(texels).then((buffer) => ({ ...this.parts.lightmapOf(buffer), address: texels }));
      // Whoever waits for it hears what is wrong with it.
      coming.catch(() => {});
      this.coming.set(texels, coming);
    }
  }

  // Pages by their numbers, without those that are too large.
  async fetchPages(lightmaps) {
    this.ask(lightmaps);
    const tooLarge = [];
    const fetched = lightmaps.map(async ({ page, texels }) => {
      const old = this.pages.get(page);
      if (old?.address === texels) return [page, old];
      try {
        return [page, await this.coming.get(texels)];
      } catch (error) {
        if (!(error instanceof TooLarge)) throw error;
        tooLarge.push(page);
        return null;
      }
    });
    try {
      const pages = new Map((await Promise.all(fetched)).filter((found) => found));
      this.tooLarge = tooLarge;
      return pages;
    } finally {
      // What failed is asked for again next time.
      this.coming.clear();
    }
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
    this.now = null;
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
