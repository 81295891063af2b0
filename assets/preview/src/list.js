// Which scenes there are, as the server tells them.

export class List {
  constructor() {
    // By their numbers, in the order of these.
    this.scenes = new Map();
    this.selected = null;
  }

  // Takes a scene as it is now; returns whether the list is another one.
  take(scene) {
    const known = this.scenes.get(scene.scene);
    if (scene.status.state === 'removed') return this.scenes.delete(scene.scene);
    // Whoever starts luxel anew at the same port counts from the beginning.
    this.scenes.set(scene.scene, scene);
    if (known?.path === scene.path) return false;
    this.scenes = new Map([...this.scenes].sort(([a], [b]) => a - b));
    return true;
  }

  // Keeps those of which the server knows; returns whether the list is another one.
  keep(numbers) {
    const gone = [...this.scenes.keys()].filter((number) => !numbers.has(number));
    gone.forEach((number) => this.scenes.delete(number));
    return gone.length > 0;
  }

  // The selected scene, or the first one where that is none; null where there is none at all.
  choose() {
    if (!this.scenes.has(this.selected)) this.selected = this.scenes.keys().next().value ?? null;
    return this.scenes.get(this.selected) ?? null;
  }
}
