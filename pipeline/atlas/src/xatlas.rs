//! The one place that talks to the xatlas library.
//!
//! The `xatlas-rs` crate compiles and links the C++ sources, but its own declarations name the symbols as MSVC
//! mangles them (other linkers do not find them), ignore the error code of `AddMesh` and hand out slices with an unbound
//! lifetime. So the few functions needed are declared here again, from `xatlas.h`, and wrapped into one call that
//! checks everything that goes in and copies and checks everything that comes out.
//!
//! xatlas may still misbehave on strange geometry: print, read out of bounds, abort, never return. This module can
//! only see to valid arguments; [`crate::worker`] puts a process between xatlas and the bake.

use std::ffi::{c_char, c_int, c_void};
use std::sync::Once;

// Pulls the C++ library into the link.
use xatlas_rs as _;

use crate::unwrap::{Piece, PieceCharts};

#[repr(C)]
struct RawChart {
    atlas_index: u32,
    index_array: *mut u32,
    index_count: u32,
}

#[repr(C)]
struct RawVertex {
    atlas_index: i32,
    uv: [f32; 2],
    xref: u32,
}

#[repr(C)]
struct RawMesh {
    chart_array: *mut RawChart,
    chart_count: u32,
    index_array: *mut u32,
    index_count: u32,
    vertex_array: *mut RawVertex,
    vertex_count: u32,
}

#[repr(C)]
struct RawAtlas {
    width: u32,
    height: u32,
    atlas_count: u32,
    chart_count: u32,
    mesh_count: u32,
    meshes: *mut RawMesh,
    utilization: *mut f32,
    texels_per_unit: f32,
}

#[repr(C)]
struct MeshDecl {
    vertex_count: u32,
    position_data: *const c_void,
    position_stride: u32,
    normal_data: *const c_void,
    normal_stride: u32,
    uv_data: *const c_void,
    uv_stride: u32,
    index_count: u32,
    index_data: *const c_void,
    index_offset: i32,
    index_format: c_int,
    face_ignore_data: *const bool,
}

#[repr(C)]
#[derive(Clone, Copy)]
struct ChartOptions {
    max_chart_area: f32,
    max_boundary_length: f32,
    proxy_fit_weight: f32,
    roundness_weight: f32,
    straightness_weight: f32,
    normal_seam_weight: f32,
    texture_seam_weight: f32,
    max_threshold: f32,
    grow_face_count: u32,
    max_iterations: u32,
}

#[repr(C)]
#[derive(Clone, Copy)]
struct PackOptions {
    attempts: c_int,
    texels_per_unit: f32,
    resolution: u32,
    max_chart_size: u32,
    block_align: bool,
    conservative: bool,
    padding: u32,
}

const INDEX_UINT32: c_int = 1;

/// xatlas's own defaults, but for stronger respect of normal seams.
const CHART_OPTIONS: ChartOptions = ChartOptions {
    max_chart_area: 0.0,
    max_boundary_length: 0.0,
    proxy_fit_weight: 2.0,
    roundness_weight: 0.01,
    straightness_weight: 6.0,
    normal_seam_weight: 4.0,
    texture_seam_weight: 0.5,
    max_threshold: 2.0,
    grow_face_count: 32,
    max_iterations: 1,
};

/// The packing is thrown away, so it is made cheap: few texels, few attempts.
const PACK_OPTIONS: PackOptions = PackOptions {
    attempts: 16,
    texels_per_unit: 16.0,
    resolution: 0,
    max_chart_size: 1024,
    block_align: false,
    conservative: false,
    padding: 0,
};

type Print = extern "C" fn(*const c_char) -> c_int;

unsafe extern "C" {
    #[cfg_attr(not(target_env = "msvc"), link_name = "_ZN6xatlas6CreateEv")]
    #[cfg_attr(target_env = "msvc", link_name = "\u{1}?Create@xatlas@@YAPEAUAtlas@1@XZ")]
    fn xatlas_create() -> *mut RawAtlas;

    #[cfg_attr(not(target_env = "msvc"), link_name = "_ZN6xatlas7DestroyEPNS_5AtlasE")]
    #[cfg_attr(target_env = "msvc", link_name = "\u{1}?Destroy@xatlas@@YAXPEAUAtlas@1@@Z")]
    fn xatlas_destroy(atlas: *mut RawAtlas);

    #[cfg_attr(not(target_env = "msvc"), link_name = "_ZN6xatlas7AddMeshEPNS_5AtlasERKNS_8MeshDeclE")]
    #[cfg_attr(
        target_env = "msvc",
        link_name = "\u{1}?AddMesh@xatlas@@YA?AW4Enum@AddMeshError@1@PEAUAtlas@1@AEBUMeshDecl@1@@Z"
    )]
    fn xatlas_add_mesh(atlas: *mut RawAtlas, decl: *const MeshDecl) -> c_int;

    #[cfg_attr(
        not(target_env = "msvc"),
        link_name = "_ZN6xatlas8GenerateEPNS_5AtlasENS_12ChartOptionsEPFvPKfPfjPKjjbENS_11PackOptionsEPFvNS_16ProgressCategory4EnumEiPvESD_"
    )]
    #[cfg_attr(
        target_env = "msvc",
        link_name = "\u{1}?Generate@xatlas@@YAXPEAUAtlas@1@UChartOptions@1@P6AXPEBMPEAMIPEBII_N@ZUPackOptions@1@P6AXW4Enum@ProgressCategory@1@HPEAX@Z9@Z"
    )]
    fn xatlas_generate(
        atlas: *mut RawAtlas,
        chart_options: ChartOptions,
        parameterize: *const c_void,
        pack_options: PackOptions,
        progress: *const c_void,
        user_data: *mut c_void,
    );

    #[cfg_attr(not(target_env = "msvc"), link_name = "_ZN6xatlas8SetPrintEPFiPKczEb")]
    #[cfg_attr(target_env = "msvc", link_name = "\u{1}?SetPrint@xatlas@@YAXP6AHPEBDZZ_N@Z")]
    fn xatlas_set_print(print: Print, verbose: bool);
}

/// Swallows xatlas's messages: they would go to standard output, which belongs to the worker's protocol.
extern "C" fn discard(_: *const c_char) -> c_int {
    0
}

/// Owns an xatlas context.
struct Handle(*mut RawAtlas);

impl Drop for Handle {
    fn drop(&mut self) {
        // SAFETY: the pointer came from `xatlas_create`, is not null and is destroyed once.
        unsafe { xatlas_destroy(self.0) }
    }
}

/// Unwraps pieces with xatlas in this process. One answer per piece, in order.
pub(crate) fn unwrap(pieces: &[Piece]) -> Vec<Result<PieceCharts, String>> {
    static QUIET: Once = Once::new();
    // SAFETY: the callback has C linkage, never reads the arguments behind the format, and lives for ever.
    QUIET.call_once(|| unsafe { xatlas_set_print(discard, false) });
    // SAFETY: no precondition.
    let handle = Handle(unsafe { xatlas_create() });
    if handle.0.is_null() {
        return pieces.iter().map(|_| Err("xatlas did not start".into())).collect();
    }
    // Each piece's mesh number within xatlas, or why it has none.
    let mut added = 0;
    let numbers: Vec<Result<usize, String>> = pieces
        .iter()
        .map(|piece| {
            add(&handle, piece)?;
            added += 1;
            Ok(added - 1)
        })
        .collect();
    if added > 0 {
        // SAFETY: the handle is valid and has meshes; null callbacks mean the built-in parameterisation, no progress.
        unsafe {
            xatlas_generate(
                handle.0,
                CHART_OPTIONS,
                std::ptr::null(),
                PACK_OPTIONS,
                std::ptr::null(),
                std::ptr::null_mut(),
            );
        }
    }
    numbers.into_iter().zip(pieces).map(|(number, piece)| read(&handle, number?, piece)).collect()
}

fn add(handle: &Handle, piece: &Piece) -> Result<(), String> {
    piece.check()?;
    let stride = size_of::<[f32; 3]>() as u32;
    let decl = MeshDecl {
        vertex_count: piece.positions.len() as u32,
        position_data: piece.positions.as_ptr().cast(),
        position_stride: stride,
        normal_data: if piece.normals.is_empty() { std::ptr::null() } else { piece.normals.as_ptr().cast() },
        normal_stride: stride,
        uv_data: std::ptr::null(),
        uv_stride: 0,
        index_count: (piece.triangles.len() * 3) as u32,
        index_data: piece.triangles.as_ptr().cast(),
        index_offset: 0,
        index_format: INDEX_UINT32,
        face_ignore_data: std::ptr::null(),
    };
    // SAFETY: `check` made sure that indices and the lengths of all arrays agree; xatlas copies what it reads.
    match unsafe { xatlas_add_mesh(handle.0, &decl) } {
        0 => Ok(()),
        code => Err(format!("xatlas refused the mesh (code {code})")),
    }
}

/// A slice that C owns; empty for a null pointer.
///
/// # Safety
/// `data` is null or points to `len` initialised elements that outlive the borrow of `handle`.
unsafe fn borrowed<T>(_handle: &Handle, data: *const T, len: u32) -> &[T] {
    if data.is_null() || len == 0 {
        return &[];
    }
    // SAFETY: the caller's promise.
    unsafe { std::slice::from_raw_parts(data, len as usize) }
}

fn read(handle: &Handle, number: usize, piece: &Piece) -> Result<PieceCharts, String> {
    // SAFETY: xatlas keeps these arrays, with these lengths, until the context is destroyed.
    let (vertices, indices, charts) = unsafe {
        let atlas = &*handle.0;
        let mesh = borrowed(handle, atlas.meshes, atlas.mesh_count).get(number).ok_or("xatlas lost the mesh")?;
        let vertices = borrowed(handle, mesh.vertex_array, mesh.vertex_count);
        let indices = borrowed(handle, mesh.index_array, mesh.index_count);
        (vertices, indices, borrowed(handle, mesh.chart_array, mesh.chart_count))
    };
    if indices.len() != piece.triangles.len() * 3 {
        return Err(format!("xatlas returned {} indices for {} triangles", indices.len(), piece.triangles.len()));
    }
    let mut chart_of_vertex = vec![u32::MAX; vertices.len()];
    for (number, chart) in charts.iter().enumerate() {
        // SAFETY: as above.
        for &index in unsafe { borrowed(handle, chart.index_array, chart.index_count) } {
            *chart_of_vertex.get_mut(index as usize).ok_or("xatlas returned a chart index out of range")? =
                number as u32;
        }
    }
    let mut out = PieceCharts::default();
    for (corners, source) in indices.chunks_exact(3).zip(&piece.triangles) {
        let mut uvs = [[0.0; 2]; 3];
        let mut chart = None;
        for k in 0..3 {
            let at = corners[k] as usize;
            let vertex = vertices.get(at).ok_or("xatlas returned an index out of range")?;
            if vertex.xref != source[k] {
                return Err("xatlas moved a triangle".into());
            }
            // A vertex without a chart (atlas −1) belongs to a triangle that xatlas ignored.
            let of = if vertex.atlas_index < 0 { u32::MAX } else { chart_of_vertex[at] };
            if *chart.get_or_insert(of) != of {
                return Err("xatlas returned a triangle in two charts".into());
            }
            uvs[k] = vertex.uv;
        }
        out.chart_of.push(chart.unwrap_or(u32::MAX));
        out.uvs.push(uvs);
    }
    Ok(out)
}
