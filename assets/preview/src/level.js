// A level as it is shown: the .glb, the light on it, and what views need to know of both.

import { Box3, BufferAttribute, Group, Vector3 } from 'three';
import { GLTFLoader } from 'three/examples/jsm/loaders/GLTFLoader.js';
import { MeshoptDecoder } from 'three/examples/jsm/libs/meshopt_decoder.module.js';
import { chartsOf } from './charts.js';
import { LightmapPlugin } from './lightmap.js';
import { viewMaterial } from './shader.js';

const loader = new GLTFLoader().setMeshoptDecoder(MeshoptDecoder).register((parser) => new LightmapPlugin(parser));

export class Level {
  // Reads a baked .glb.
  static async parse(buffer) {
    return new Level(await loader.parseAsync(buffer, ''));
  }

  constructor(gltf) {
    this.root = new Group().add(gltf.scene);
    this.root.updateMatrixWorld(true);
    this.camera = gltf.cameras.find((camera) => camera.isPerspectiveCamera) ?? null;
    this.materials = [];
    this.lit = this.unlit = 0;
    const objects = [];
    this.root.traverse((object) => { if (object.isMesh) objects.push(object); });
    const meshes = objects.filter((mesh) => mesh.geometry.hasAttribute('position'));
    this.charts = number(meshes);
    const known = new Map();
    for (const mesh of meshes) {
      // Which attributes there are decides what a material does, so each kind of both is one.
      const key = `${mesh.material.uuid} ${Object.keys(mesh.geometry.attributes).sort()}`;
      if (!known.has(key)) {
        const shown = viewMaterial(mesh.material, mesh.geometry);
        shown.userData = { lightmap: shown.defines.LIGHTMAP_SET ? mesh.material.userData.lightmap : null };
        known.set(key, shown);
        this.materials.push(shown);
      }
      mesh.material = known.get(key);
      mesh.frustumCulled = !mesh.isSkinnedMesh;
      if (mesh.material.userData.lightmap) this.lit += 1; else this.unlit += 1;
    }
    this.bounds = new Box3().setFromObject(this.root);
    if (this.bounds.isEmpty()) this.bounds.set(new Vector3(-1, -1, -1), new Vector3(1, 1, 1));
  }

  // Puts light on the level: from the pages of the atlas, or from the pictures within the .glb.
  light(pages, fromBytes) {
    for (const material of this.materials) {
      const { lightmap } = material.userData;
      if (!lightmap) continue;
      const page = pages.get(lightmap.page);
      const { uniforms } = material;
      uniforms.texels.value = page?.texture ?? null;
      uniforms.lightmapSize.value.set(page?.width ?? 1, page?.height ?? 1);
      const bytes = fromBytes || !page;
      uniforms.lightmap.value = bytes ? lightmap.picture : page.texture;
      uniforms.lightmapScale.value = bytes ? lightmap.intensity : page.scale;
    }
  }

  dispose() {
    this.root.traverse((object) => { if (object.isMesh) object.geometry.dispose(); });
    for (const material of this.materials) {
      const { baseMap, emissiveMap, metalMap } = material.uniforms;
      for (const map of [baseMap.value, emissiveMap.value, metalMap.value]) map?.dispose();
      material.userData.lightmap?.picture?.dispose();
      material.dispose();
    }
  }
}

// Gives the vertices of all lightmapped meshes the number of their chart; returns how many there are.
function number(meshes) {
  const parts = [];
  for (const { geometry, material } of meshes) {
    const lightmap = material.userData.lightmap;
    const uv = lightmap && geometry.getAttribute(lightmap.channel === 0 ? 'uv' : `uv${lightmap.channel}`);
    if (!uv) continue;
    const flat = new Float32Array(2 * uv.count);
    for (let i = 0; i < uv.count; i++) [flat[2 * i], flat[2 * i + 1]] = [uv.getX(i), uv.getY(i)];
    parts.push({ geometry, page: lightmap.page, uv: flat, index: geometry.index?.array ?? null });
  }
  const { lists, count } = chartsOf(parts);
  parts.forEach(({ geometry }, i) => geometry.setAttribute('chart', new BufferAttribute(lists[i], 1)));
  return count;
}
