import assert from 'node:assert/strict';
import { test } from 'node:test';
import { chartsOf } from '../src/charts.js';

// Two triangles with a common edge, and one apart.
const square = { page: 0, uv: [0, 0, 1, 0, 1, 1, 0, 1], index: [0, 1, 2, 0, 2, 3] };
const apart = { page: 0, uv: [2, 0, 3, 0, 3, 1], index: null };

test('triangles with common corners are one chart', () => {
  const { lists, count } = chartsOf([square, apart]);
  assert.equal(count, 2);
  assert.deepEqual(lists.map((list) => [...list]), [[0, 0, 0, 0], [1, 1, 1]]);
});

test('corners are common across primitives, and by their bits', () => {
  const beside = { page: 0, uv: [1, -0, 1, 1, 2, 1], index: null };
  assert.equal(chartsOf([square, beside]).count, 1);
  const near = { page: 0, uv: [1, 2 ** -149, 1 + 2 ** -23, 1, 2, 1].map(Math.fround), index: null };
  assert.equal(chartsOf([square, near]).count, 2);
});

test('the same place on another page is another chart', () => {
  assert.equal(chartsOf([square, { ...square, page: 1 }]).count, 2);
});

test('vertices without a triangle are in no chart', () => {
  const { lists, count } = chartsOf([{ page: 0, uv: [0, 0, 1, 0, 1, 1, 5, 5], index: [0, 1, 2] }]);
  assert.deepEqual([[...lists[0]], count], [[0, 0, 0, -1], 1]);
});
