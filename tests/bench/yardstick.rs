//! How fast this machine is at discrete rays as such: the paper's literal exchange (Piwowar & Malgouyres 2009, §2) in
//! its leanest form, on the same surfels. One sweep serves both senses of a direction, and nothing keeps the rule from
//! losing light, so it bounds from above what a correct rule can reach. The goals on discrete rays were set where it
//! ran at [`THERE`].

use std::hint::black_box;

use glam::{Vec3, Vec4};
use luxel_transport::{directions::Direction, surfel::Surfels};

/// Rays a second of this kernel on the machine on which the goals were set: 0.65 ns a ray at 104k surfels.
pub const THERE: f64 = 1.0 / 0.65e-9;

/// The line has met no emitter.
const NOTHING: u32 = u32::MAX;

#[derive(Clone, Copy)]
struct Element {
    normal: Vec3,
    /// Cell of its line, before the shift of its slice.
    key: u32,
    radiosity: Vec4,
    sum: Vec4,
}

/// The surfels slice by slice along x.
pub struct Yardstick {
    elements: Vec<Element>,
    slices: Vec<usize>,
    size: [i32; 3],
    stride: u32,
}

impl Yardstick {
    pub fn new(surfels: &Surfels) -> Self {
        let size = surfels.grid.size;
        let size = [0, 1, 2].map(|k| size[k]);
        let stride = (size[2] + size[0] + 2) as u32;
        let mut list: Vec<_> = surfels.list.iter().map(|s| (s.voxel().to_array(), s.normal)).collect();
        list.sort_by_key(|(voxel, _)| *voxel);
        let slices = (0..=size[0]).map(|x| list.partition_point(|(v, _)| i64::from(v[0]) < i64::from(x))).collect();
        let element = |(voxel, normal): &([_; 3], Vec3)| Element {
            normal: *normal,
            key: voxel[1] as u32 * stride + voxel[2] as u32,
            radiosity: Vec4::ONE,
            sum: Vec4::ZERO,
        };
        Self { elements: list.iter().map(element).collect(), slices, size, stride }
    }

    /// Discrete rays of one sweep per direction: σ and −σ are two.
    pub fn rays(&self, directions: &[Direction]) -> f64 {
        2.0 * self.elements.len() as f64 * directions.len() as f64
    }

    /// One sweep for each direction that goes furthest along x.
    pub fn sweep(&mut self, directions: &[Direction], table: &mut Vec<u32>) {
        for direction in directions {
            let s = direction.sigma * direction.sigma.x.signum();
            let floor = |slope: f32, x: i32| (slope * x as f32).floor() as i32;
            let slopes = [s.y / s.x, s.z / s.x];
            let most = slopes.map(|m| floor(m, 0).max(floor(m, self.size[0] - 1)));
            table.clear();
            table.resize((self.size[1] + self.size[0]) as usize * self.stride as usize, NOTHING);
            for x in 0..self.size[0] {
                let [y, z] = [0, 1].map(|k| (most[k] - floor(slopes[k], x)) as u32);
                let shift = y * self.stride + z;
                for i in self.slices[x as usize]..self.slices[x as usize + 1] {
                    self.meet(i, shift, s, table);
                }
            }
        }
        black_box(&self.elements);
    }

    /// Those that light leaves only store their number; those that it arrives at exchange with it.
    #[inline(always)]
    fn meet(&mut self, i: usize, shift: u32, sigma: Vec3, table: &mut [u32]) {
        let here = self.elements[i];
        let along = here.normal.dot(sigma);
        let cell = &mut table[(here.key + shift) as usize];
        if along > 0.0 {
            *cell = i as u32;
        } else if let Some(there) = self.elements.get_mut(*cell as usize) {
            *cell = NOTHING;
            there.sum += here.radiosity * there.normal.dot(sigma);
            let radiosity = there.radiosity;
            self.elements[i].sum -= radiosity * along;
        }
    }
}
