//! What the importer is asked to do, and how much it accepts.

/// How a scene is read.
#[derive(Clone, Debug, PartialEq)]
pub struct ImportOptions {
    /// Share of a fully rough metal's specular colour that counts as diffuse, in [0, 1]. Default 0.5.
    pub metal_diffuse: f32,
    /// Factor on the intensity of every punctual light, for exporters with other units. Default 1.
    pub light_scale: f32,
    /// Factor on the radiance of every emissive surface. Default 1.
    pub emissive_scale: f32,
    /// Radius of point and spot lights without the extra `luxel_radius` [scene units]. Default 0.
    pub lamp_radius: f64,
    /// Angular diameter of directional lights without the extra `luxel_angle` [degrees, 0 to 180]. Default 0.
    pub sun_angle: f64,
    /// Bake skinned, morphed and animated nodes in their rest pose; by default they are left out, with a notice.
    pub bake_animated: bool,
    pub limits: Limits,
}

impl Default for ImportOptions {
    fn default() -> Self {
        Self {
            metal_diffuse: 0.5,
            light_scale: 1.0,
            emissive_scale: 1.0,
            lamp_radius: 0.0,
            sun_angle: 0.0,
            bake_animated: false,
            limits: Limits::default(),
        }
    }
}

/// Bounds on untrusted input. Each is checked before the memory or the time it stands for is spent, and the error
/// names it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Bytes of any one file.
    pub file_bytes: u64,
    /// Bytes of all files of a scene together.
    pub input_bytes: u64,
    /// Bytes of the JSON document.
    pub json_bytes: u64,
    /// Nesting of the JSON document; values above 120 count as 120.
    pub json_depth: u32,
    /// Nodes in the document.
    pub nodes: u64,
    /// Placed meshes, GPU instances expanded.
    pub instances: u64,
    /// Triangles in the world, instances expanded.
    pub triangles: u64,
    /// Bytes of all decoded geometry together.
    pub geometry_bytes: u64,
    /// Decoded geometry may exceed the bytes that were read by this factor (and 64 MiB on top): sparse accessors,
    /// compression and shared accessors can claim any size from a small file.
    pub expansion: u64,
    /// Pixels of any one image.
    pub image_pixels: u64,
    /// Bytes of all decoded images together.
    pub texture_bytes: u64,
    /// How many folders above the scene's own a relative path may lead.
    pub parent_levels: u32,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            file_bytes: 8 << 30,
            input_bytes: 16 << 30,
            json_bytes: 512 << 20,
            json_depth: 96,
            nodes: 4_000_000,
            instances: 2_000_000,
            triangles: 50_000_000,
            geometry_bytes: 12 << 30,
            expansion: 256,
            image_pixels: 1 << 28,
            texture_bytes: 6 << 30,
            parent_levels: 2,
        }
    }
}
