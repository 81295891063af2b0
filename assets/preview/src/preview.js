// The page: what the server tells goes to the viewer, what a person asks for too.

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

const viewer = new Viewer(at('picture'));
const scenes = new Map();
const shown = new Shown(viewer, onShown);
shown.onDrawn = onDrawn;
let selected = null;

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
  const scene = scenes.get(selected);
  if (!scene) return;
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
  if (state !== 'failed' && !facts) lines.push('waiting for its first bake');
  if (state === 'removed') lines.push('the scene file has gone');
  at('status').textContent = lines.join('\n');
  trouble('scene', state === 'failed' ? [`${scene.name} cannot be baked as it is now${facts ? '; this is its last good bake' : ''}`, error, ...causes].join('\n') : null);
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
  } catch (error) {
    console.error(error);
    trouble('page', `the page cannot show what was baked: ${error.message}`);
  }
}

function select(number) {
  selected = number;
  at('scenes').value = number;
  describe();
  follow(scenes.get(number));
}

function onScene(scene) {
  const known = scenes.get(scene.scene);
  scene.heard = performance.now();
  // Whoever starts luxel anew at the same port counts from the beginning.
  scenes.set(scene.scene, scene);
  if (!known || known.path !== scene.path) {
    const options = [...scenes.values()].map(({ scene: number, path }) => new Option(path, number));
    at('scenes').replaceChildren(...options);
    at('scenes').hidden = scenes.size < 2;
    if (selected !== null) at('scenes').value = selected;
  }
  if (selected === null) select(scene.scene);
  else if (selected === scene.scene) {
    describe();
    follow(scene);
  }
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
  shown.setBytes(event.target.checked, scenes.get(selected)).catch((error) => trouble('page', error.message));
});
at('scenes').addEventListener('change', (event) => select(Number(event.target.value)));
window.addEventListener('keydown', (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === 'SELECT') return;
  const view = VIEWS[Number(event.key) - 1];
  if (view) setView(view);
  else if (event.key === '0') expose();
});

setView('lit');
listen(onScene, (text) => trouble('server', text));
