// Opens the page in a headless browser and looks at it: node browser.mjs URL FOLDER CHROMIUM
//
// Every line of the output is a JSON object. `waiting` is told once the page knows a scene that was never baked; `shown` follows when each view was photographed into FOLDER; from then on
// the program waits for another light, which `updated` reports as soon as it is drawn, and `done` follows when that was
// photographed too. It ends with 1 where the page says that something is wrong.

import { chromium } from 'playwright-core';

const [url, folder, executablePath] = process.argv.slice(2);
const tell = (event, more = {}) => process.stdout.write(`${JSON.stringify({ event, ...more })}\n`);

const args = ['--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--ignore-gpu-blocklist'];
const browser = await chromium.launch({ executablePath, args });
const page = await browser.newPage({ viewport: { width: 960, height: 640 } });
const errors = [];
page.on('console', (message) => { if (['error', 'warning'].includes(message.type())) errors.push(message.text()); });
page.on('pageerror', (error) => errors.push(String(error)));

const revision = () => page.evaluate(() => Number(document.documentElement.dataset.revision ?? 0));
const drawn = () => page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
const photograph = async (name) => {
  await drawn();
  await page.screenshot({ path: `${folder}/${name}.png` });
};

await page.goto(url);
await page.waitForFunction(() => document.getElementById('status').textContent.includes('waiting'), null, { timeout: 90_000 });
tell('waiting');
await page.waitForFunction(() => document.documentElement.dataset.revision, null, { timeout: 90_000 });
await page.evaluate(() => { window.kept = 'since the beginning'; });
for (const [i, view] of ['lit', 'lightmap', 'albedo', 'density', 'charts', 'invalid'].entries()) {
  await page.keyboard.press(String(i + 1));
  await photograph(view);
}
await page.keyboard.press('1');
await page.click('#bytes');
await photograph('bytes');
await page.click('#bytes');
await drawn();
const before = await revision();
tell('shown', { revision: before });
await page.waitForFunction((old) => Number(document.documentElement.dataset.revision) > old, before, { timeout: 90_000 });
tell('updated', { revision: await revision() });
await photograph('changed');
// The second scene, whose camera stands where texels are buried.
await page.selectOption('#scenes', '1');
await page.waitForFunction((last) => document.documentElement.dataset.revision !== last, String(await revision()), { timeout: 90_000 });
await page.keyboard.press('6');
await photograph('buried');
const kept = await page.evaluate(() => window.kept ?? null);
const trouble = await page.evaluate(() => (document.getElementById('trouble').hidden ? null : document.getElementById('trouble').textContent));
tell('done', { kept, trouble, errors });
await browser.close();
