import assert from 'node:assert/strict';
import { test } from 'node:test';
import { Overtaken, TooLarge } from '../src/feed.js';
import { List } from '../src/list.js';
import { Shown } from '../src/shown.js';

// A viewer that writes down what it shows; files that are there, that fail, or that are held back.
class Bench {
  constructor() {
    Object.assign(this, { files: new Map(), asked: [], level: null, light: null });
    const viewer = {
      show: (level) => { viewer.level = this.level = level; },
      clear: () => { viewer.level = this.level = null; },
      draw: () => {},
      wake: () => {},
    };
    const parts = {
      bytes: async (address) => {
        this.asked.push(address);
        const file = await (this.files.get(address) ?? address);
        if (file instanceof Error) throw file;
        return file;
      },
      lightmapOf: (buffer) => ({ texture: { dispose: () => {} }, from: buffer }),
      parse: async (buffer) => ({ from: buffer, light: (pages) => { this.light = [...pages.values()].map((page) => page.from); } }),
    };
    this.shown = new Shown(viewer, () => {}, parts);
  }

  // Holds a file back; returns what lets it come.
  hold(address) {
    let go;
    this.files.set(address, new Promise((done) => { go = () => done(address); }));
    return go;
  }

  get on() {
    return this.level?.from ?? null;
  }
}

const scene = (path, version, more = {}) => ({
  path,
  status: { state: 'current' },
  outputs: {
    glb: `${path} glb ${version}`,
    lightmaps: [{ page: 0, texels: `${path} texels ${version}` }],
    layout: `${path} layout`,
    content: `${path} content`,
    pending: false,
    ...more,
  },
});

test('new light is swapped without the level being loaded again', async () => {
  const bench = new Bench();
  await bench.shown.follow(scene('a', 1));
  await bench.shown.follow(scene('a', 2));
  assert.deepEqual([bench.on, bench.light], ['a glb 1', ['a texels 2']]);
});

test('a scene that cannot be fetched does not leave the last one under its name', async () => {
  const bench = new Bench();
  await bench.shown.follow(scene('a', 1));
  bench.files.set('b glb 1', new Error('no'));
  await assert.rejects(bench.shown.follow(scene('b', 1)), /no/);
  assert.deepEqual([bench.on, bench.shown.path], [null, null]);
  bench.files.delete('b glb 1');
  await bench.shown.follow(scene('b', 1));
  assert.equal(bench.on, 'b glb 1');
  // The same scene's earlier light stays, and its name is right.
  bench.files.set('b texels 2', new Overtaken());
  await assert.rejects(bench.shown.follow(scene('b', 2)), /replaced/);
  assert.deepEqual([bench.on, bench.light], ['b glb 1', ['b texels 1']]);
});

test('what is wanted meanwhile is shown even where the one before fails', async () => {
  const bench = new Bench();
  for (const wrong of ['big texels 1', 'big glb 1']) {
    const go = bench.hold('big texels 1');
    bench.files.set('big glb 1', new Error('too big'));
    if (wrong === 'big texels 1') bench.files.set(wrong, new Promise((_, fail) => setTimeout(() => fail(new Error('too big')), 20)));
    const big = bench.shown.follow(scene('big', 1));
    const small = bench.shown.follow(scene('c', 1));
    go();
    await Promise.all([big, small]);
    assert.equal(bench.on, 'c glb 1', wrong);
    bench.shown.clear();
  }
});

test('a lightmap that is too large is shown by the pictures of the .glb', async () => {
  const bench = new Bench();
  bench.files.set('a texels 1', new TooLarge());
  bench.files.set('a texels 2', new TooLarge());
  await bench.shown.follow(scene('a', 1));
  assert.deepEqual([bench.on, bench.light, bench.shown.tooLarge], ['a glb 1', [], [0]]);
  // Other light is other pictures: the .glb is loaded although nothing but light is new.
  await bench.shown.follow(scene('a', 2));
  assert.equal(bench.on, 'a glb 2');
  await bench.shown.follow(scene('a', 3));
  assert.deepEqual([bench.light, bench.shown.tooLarge], [['a texels 3'], []]);
});

test('light is fetched while the server looks into the level, and once', async () => {
  const bench = new Bench();
  await bench.shown.follow(scene('a', 1));
  const go = bench.hold('a texels 2');
  await bench.shown.follow(scene('a', 2, { pending: true, layout: null, content: null }));
  assert.deepEqual([bench.asked.at(-1), bench.light], ['a texels 2', ['a texels 1']]);
  const settled = bench.shown.follow(scene('a', 2));
  go();
  await settled;
  assert.deepEqual([bench.on, bench.light], ['a glb 1', ['a texels 2']]);
  assert.equal(bench.asked.filter((address) => address === 'a texels 2').length, 1);
  // Of a scene that was not on show before there is nothing to wait for; what is told later makes no difference.
  await bench.shown.follow(scene('b', 1, { pending: true, layout: null, content: null }));
  assert.equal(bench.on, 'b glb 1');
  const asked = bench.asked.length;
  await bench.shown.follow(scene('b', 1));
  assert.equal(bench.asked.length, asked);
  await bench.shown.follow(scene('b', 2));
  assert.deepEqual([bench.on, bench.light], ['b glb 1', ['b texels 2']]);
});

test('a scene without outputs shows nothing', async () => {
  const bench = new Bench();
  await bench.shown.follow(scene('a', 1));
  await bench.shown.follow({ path: 'b', status: { state: 'waiting' }, outputs: null });
  assert.equal(bench.on, null);
});

const told = (number, path, state = 'current') => ({ scene: number, path, status: { state } });

test('the list follows what the server tells', () => {
  const list = new List();
  assert.equal(list.choose(), null);
  assert.ok(list.take(told(1, 'b')) && list.take(told(0, 'a')));
  assert.ok(!list.take(told(0, 'a', 'baking')));
  assert.deepEqual([...list.scenes.keys()], [0, 1]);
  list.selected = 1;
  assert.equal(list.choose().path, 'b');
  // A scene that has gone is in no list; what was selected may be another one then.
  assert.ok(list.take(told(1, 'b', 'removed')) && !list.take(told(1, 'b', 'removed')));
  assert.equal(list.choose().path, 'a');
  // Another server with fewer scenes, and with others.
  list.take(told(1, 'b'));
  assert.ok(list.take(told(0, 'c')) && list.keep(new Set([0])) && !list.keep(new Set([0])));
  assert.deepEqual([...list.scenes.values()].map((s) => s.path), ['c']);
  list.keep(new Set());
  assert.equal(list.choose(), null);
  assert.equal(list.selected, null);
});
