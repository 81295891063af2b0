// Light as the server sends it, and the plugin that finds out where three.js is to put it.

import { ClampToEdgeWrapping, DataTexture, HalfFloatType, LinearFilter, NoColorSpace, RGBAFormat } from 'three';

const HEADER = 16;

// A lightmap from its texels: width, height, scale and 0, then four half floats a texel (R, G, B = E / scale in lux,
// A = coverage, negative where the texel's point is buried). Row 0 is at v = 0, as in glTF.
export function lightmapOf(buffer) {
  const view = new DataView(buffer);
  const [width, height] = [view.getUint32(0, true), view.getUint32(4, true)];
  const halves = new Uint16Array(buffer, HEADER);
  if (halves.length !== 4 * width * height) throw new Error('a lightmap has the wrong length');
  const texture = new DataTexture(halves, width, height, RGBAFormat, HalfFloatType);
  return { texture: linear(texture), scale: view.getFloat32(8, true), width, height };
}

// No mipmaps: charts would bleed into each other.
function linear(texture) {
  texture.magFilter = texture.minFilter = LinearFilter;
  texture.wrapS = texture.wrapT = ClampToEdgeWrapping;
  texture.generateMipmaps = false;
  texture.flipY = false;
  texture.colorSpace = NoColorSpace;
  texture.needsUpdate = true;
  return texture;
}

// Reads MOZ_lightmap, which GLTFLoader passes over: sets `material.userData.lightmap` to the page of the atlas, the set
// of coordinates and the picture within the .glb, whose texels times `intensity` are E in lux.
export class LightmapPlugin {
  constructor(parser) {
    this.name = 'MOZ_lightmap';
    this.parser = parser;
  }

  async afterRoot(gltf) {
    const materials = new Set();
    gltf.scenes.forEach((scene) => scene.traverse((object) => {
      if (object.isMesh) [object.material].flat().forEach((material) => materials.add(material));
    }));
    await Promise.all([...materials].map((material) => this.read(material)));
  }

  async read(material) {
    const index = this.parser.associations.get(material)?.materials;
    const found = this.parser.json.materials?.[index]?.extensions?.[this.name];
    if (found === undefined) return;
    const source = await this.parser.getDependency('texture', found.index);
    // The loader gives out one texture to all who ask, with the settings of who asked first.
    const picture = source === null ? null : linear(source.clone());
    material.userData.lightmap = {
      page: material.userData.luxel?.page ?? 0,
      channel: found.texCoord ?? 1,
      intensity: found.intensity ?? 1,
      picture,
    };
  }
}
