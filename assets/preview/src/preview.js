// The page: what the server tells goes to the viewer, what a person asks for too.

import { List } from './list.js';
import { Shown } from './shown.js';
import { Viewer } from './viewer.js';
import { VIEWS, common } from './shader.js';
import { listen } from './feed.js';

const at = (id) => document.getElementById(id);

const LEGENDS = {
  lit: () => 'ρE/π + Lₑ: diffuse reflection of the baked light, and what shines by itself',
  lightmap: () => 'E/π: the baked light on white surfaces',
  albedo: () => 'ρ: what surfaces reflect, as luxel bakes it',
  density: () => `<div class="ramp" id="ramp"></div><div class="ends"><span>¼</span><span>${figure(common.usualDensity.value)} texels a unit</span><span>4×</span></div>checks of 8 × 8 texels`,
  charts: () => `${viewer.level?.charts ?? 0} charts, each of one colour`,
  invalid: () => [['buried', 'inside or under other geometry: filled from neighbours'], ['partial', 'less than half of the texel is covered'], ['outside', 'padding: no chart covers this texel']]
    .map(([kind, text]) => `<div><i class="${kind}"></i>${text}</div>`).join(''),
};

const viewer = open();
const list = new List();
const shown = new Shown(viewer, onShown);
shown.onDrawn = onDrawn;

function open() {
  try {
    return new Viewer(at('picture'));
  } catch (error) {
    at('trouble').hidden = false;
    at('trouble').textContent = `this browser draws nothing in three dimensions: WebGL 2 is switched off or not to be had\n${error.message}`;
    throw error;
  }
}

const figure = (x) => (x >= 1000 ? x.toFixed(0) : x.toPrecision(3));

function setView(name) {
  viewer.view = name;
  for (const button of at('views').children) button.setAttribute('aria-pressed', button.dataset.view === name);
  at('legend').innerHTML = LEGENDS[name]();
  at('exposing').hidden = !['lit', 'lightmap'].includes(name);
}

function setStops(stops) {
  viewer.stops = stops;
  at('exposure').value = stops;
  at('stops').value = `${stops > 0 ? '+' : ''}${stops.toFixed(1)} EV`;
  viewer.wake();
}

function expose() {
  viewer.expose();
  setStops(0);
}

// Before new light is drawn: what it is measured by.
function onShown(scene, level) {
  const facts = scene.outputs?.facts ?? {};
  common.meanIrradiance.value = facts.mean_irradiance_lux ?? 0;
  common.usualDensity.value = facts.texels_per_unit || 1;
  common.metalDiffuse.value = facts.metal_diffuse ?? 0.5;
  common.emissiveScale.value = facts.emissive_scale ?? 1;
}

// After it was drawn. Exposure stays when a scene changes, or a brighter lamp would not show.
function onDrawn(scene, isLevel, isOther) {
  if (isOther) expose();
  if (isLevel) setView(viewer.view);
  // For programs that look at the page.
  document.documentElement.dataset.milliseconds = (performance.now() - scene.heard).toFixed(0);
  document.documentElement.dataset.revision = scene.revision;
  describe();
}

function describe() {
  const scene = list.scenes.get(list.selected);
  if (!scene) {
    at('name').textContent = 'no scene';
    at('status').textContent = '';
    return trouble('scene', null);
  }
  at('name').textContent = scene.name;
  const { state, error, causes = [] } = scene.status;
  const facts = scene.outputs?.facts;
  const lines = [];
  if (facts) {
    const mean = facts.mean_irradiance_lux;
    lines.push(`${facts.preset ?? ''} bake of ${facts.seconds.toFixed(1)} s${mean === null ? '' : `, mean E ${figure(mean)} lux`}`);
    if (facts.only && facts.only !== 'all') lines.push(`only ${facts.only} light`);
    const unlit = viewer.level?.unlit ?? 0;
    if (unlit) lines.push(`${unlit} objects without lightmap: shown under the mean light`);
    if (facts.warnings.length) lines.push(`${facts.warnings.length} warnings in the report`);
  }
  if (state === 'baking') lines.push('baking …');
  if (state === 'waiting' && facts) lines.push('waiting: this is what was baked last');
  if (state !== 'failed' && !facts) lines.push('waiting for its first bake');
  if (shown.tooLarge.length) {
    lines.push(`more than 8192 × 8192 texels: shown by the 8-bit pictures of the .glb (page ${shown.tooLarge.join(', ')})`);
  }
  at('status').textContent = lines.join('\n');
  trouble('scene', state === 'failed' ? [`${scene.name} cannot be baked as it is now${facts ? `; this is ${facts.draft ? 'a draft' : 'its last good bake'}` : ''}`, error, ...causes].join('\n') : null);
}

// What is wrong, by whom it concerns; the server's silence is told before a scene's fault.
const troubles = new Map();
function trouble(whose, text) {
  troubles.set(whose, text);
  const first = ['server', 'page', 'scene'].map((who) => troubles.get(who)).find((told) => told);
  at('trouble').hidden = !first;
  at('trouble').textContent = first ?? '';
}

async function follow(scene) {
  try {
    await shown.follow(scene);
    trouble('page', null);
    describe();
  } catch (error) {
    console.error(error);
    trouble('page', `the page cannot show what was baked: ${error.message}`);
  }
}

// What is selected is on show, as it is now.
function select(number) {
  list.selected = number;
  const scene = list.choose();
  at('scenes').value = list.selected;
  describe();
  if (scene) follow(scene);
  else shown.clear();
}

function listed() {
  at('scenes').replaceChildren(...[...list.scenes.values()].map(({ scene: number, path }) => new Option(path, number)));
  at('scenes').hidden = list.scenes.size < 2;
  at('scenes').value = list.selected;
}

function onScene(scene) {
  const known = list.scenes.get(scene.scene);
  // What is told of the same files for the second time was heard of before.
  const isMore = known?.outputs?.pending && known.outputs.glb === scene.outputs?.glb;
  scene.heard = isMore ? known.heard : performance.now();
  const before = list.selected;
  const isOther = list.take(scene);
  list.choose();
  if (isOther) listed();
  if (list.selected !== before || list.selected === scene.scene) select(list.selected);
}

// What the server does not know is not there: it may be another one than before.
function onAll(numbers) {
  const before = list.selected;
  if (!list.keep(numbers)) return;
  list.choose();
  listed();
  if (list.selected !== before) select(list.selected);
}

for (const [i, view] of VIEWS.entries()) {
  const button = Object.assign(document.createElement('button'), { type: 'button', textContent: view, title: `key ${i + 1}` });
  button.dataset.view = view;
  button.addEventListener('click', () => setView(view));
  at('views').append(button);
}
at('exposure').addEventListener('input', (event) => setStops(Number(event.target.value)));
at('auto').addEventListener('click', expose);
at('bytes').addEventListener('change', (event) => {
  shown.setBytes(event.target.checked, list.scenes.get(list.selected)).catch((error) => trouble('page', error.message));
});
at('scenes').addEventListener('change', (event) => select(Number(event.target.value)));
window.addEventListener('keydown', (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === 'SELECT') return;
  const view = VIEWS[Number(event.key) - 1];
  if (view) setView(view);
  else if (event.key === '0') expose();
});

setView('lit');
listen({ onScene, onAll, onTrouble: (text) => trouble('server', text) });
