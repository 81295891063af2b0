// Follows a watch in a headless browser: node follow.mjs URL FOLDER CHROMIUM
//
// Every line of the output is a JSON object. `shown` is told when a level is on show and was photographed into FOLDER;
// then the program waits for other light, and `done` follows when that is on show, and nothing is being baked any more.

import { chromium } from 'playwright-core';

const [url, folder, executablePath] = process.argv.slice(2);
const tell = (event, more = {}) => process.stdout.write(`${JSON.stringify({ event, ...more })}\n`);

const args = ['--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--ignore-gpu-blocklist'];
const browser = await chromium.launch({ executablePath, args });
const page = await browser.newPage({ viewport: { width: 960, height: 640 } });
const photograph = async (name) => {
  await page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
  await page.screenshot({ path: `${folder}/${name}.png` });
};
const rested = (old) => page.waitForFunction((last) => {
  const { revision } = document.documentElement.dataset;
  return revision && Number(revision) > last && !/baking|waiting/.test(document.getElementById('status').textContent);
}, old, { timeout: 90_000 });

await page.goto(url);
await rested(0);
await page.evaluate(() => { window.kept = 'since the beginning'; });
await photograph('first');
const before = await page.evaluate(() => Number(document.documentElement.dataset.revision));
tell('shown', { revision: before });
await rested(before);
await photograph('second');
const kept = await page.evaluate(() => window.kept ?? null);
const trouble = await page.evaluate(() => (document.getElementById('trouble').hidden ? null : document.getElementById('trouble').textContent));
tell('done', { kept, trouble });
await browser.close();
