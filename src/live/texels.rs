//! A lightmap as a graphics card takes it: decoded here, because a browser needs many times as long for an .exr.
//!
//! All numbers are little-endian: width, height (u32), scale (f32), 0 (u32), then rows from v = 0 on of four half
//! floats a texel: R, G, B = E / scale with E in lux, and A = the share of the texel that its chart covers, negative
//! where the texel's point lies inside or under other geometry. The scale is 1 unless the light is beyond half floats.

use std::io::Cursor;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread;

use exr::block::chunk::Chunk;
use exr::block::{UncompressedBlock, read};
use exr::meta::{BlockDescription, MetaData, attribute::SampleType, header::Header};
use exr::prelude::f16;
use luxel_export::openexr::BURIED;

/// No more texels are decoded: they fill 512 MiB, and more of a browser's memory.
const MAX_TEXELS: usize = 1 << 26;
/// Nor wider and higher pictures.
const MAX_SIDE: usize = 1 << 16;
/// A larger file holds more than that.
pub const MAX_BYTES: u64 = 24 * MAX_TEXELS as u64;
/// Four numbers and, for each texel, four half floats.
const HEADER: usize = 16;
const TEXEL: usize = 8;
/// The largest number that is laid on a half float (the largest of all is 65504).
const MAX_HALF: f32 = 60_000.0;
/// Threads at most. They are no bake's, which has its own pool and may be at work, as after a draft.
const MOST_THREADS: usize = 8;

/// Why a lightmap is not decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// It has more texels than are decoded.
    Large,
    /// It is no .exr, or not one that luxel writes.
    Broken,
}

/// The texels of an .exr that luxel wrote.
pub fn decode(exr: &[u8]) -> Result<Vec<u8>, Fault> {
    let broken = |_| Fault::Broken;
    let meta = MetaData::read_from_buffered(Cursor::new(exr), false).map_err(broken)?;
    let fits = |h: &Header| {
        let (width, height) = (h.layer_size.0, h.layer_size.1);
        width.max(height) <= MAX_SIDE && width * height <= MAX_TEXELS && h.channels.list.len() <= 8
    };
    if !meta.headers.iter().all(fits) {
        return Err(Fault::Large);
    }
    let chunks = read(Cursor::new(exr), false).and_then(|reader| reader.all_chunks(false)?.collect());
    let picture = Picture::new(&meta, chunks.map_err(broken)?)?;
    let (texels, most) = picture.texels(1.0)?;
    // Light beyond half floats is rare, so it is known when all is decoded.
    if most > MAX_HALF { picture.texels(most / MAX_HALF).map(|(texels, _)| texels) } else { Ok(texels) }
}

/// A file that was taken apart, and nothing of it decoded.
struct Picture<'a> {
    meta: &'a MetaData,
    header: &'a Header,
    chunks: Vec<Chunk>,
    /// Places of R, G, B and A in the list of channels, and of the buried texels where there are any.
    channels: [usize; 4],
    buried: Option<usize>,
}

impl<'a> Picture<'a> {
    fn new(meta: &'a MetaData, chunks: Vec<Chunk>) -> Result<Self, Fault> {
        let [header] = &meta.headers[..] else { return Err(Fault::Broken) };
        if header.deep || header.blocks != BlockDescription::ScanLines {
            return Err(Fault::Broken);
        }
        let place = |name: &str| header.channels.list.iter().position(|c| c.name.eq(name));
        let band = |name: &str| place(name).ok_or(Fault::Broken);
        let channels = [band("R")?, band("G")?, band("B")?, band("A")?];
        Ok(Self { meta, header, chunks, channels, buried: place(BURIED) })
    }

    /// Header and texels, with light divided by `scale`, and the most light that is finite.
    fn texels(&self, scale: f32) -> Result<(Vec<u8>, f32), Fault> {
        let (width, height) = (self.header.layer_size.0, self.header.layer_size.1);
        let mut texels = vec![0; HEADER + TEXEL * width * height];
        let (header, rows) = texels.split_at_mut(HEADER);
        let numbers = [width as u32, height as u32, scale.to_bits(), 0].map(u32::to_le_bytes);
        header.copy_from_slice(numbers.as_flattened());
        let rows: Vec<Mutex<&mut [u8]>> = rows.chunks_exact_mut(TEXEL * width.max(1)).map(Mutex::new).collect();
        let (next, filled) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let work = || -> Result<f32, Fault> {
            let mut most = 0.0f32;
            while let Some(chunk) = self.chunks.get(next.fetch_add(1, Ordering::Relaxed)) {
                let (count, light) = self.block(chunk, &rows, scale)?;
                filled.fetch_add(count, Ordering::Relaxed);
                most = most.max(light);
            }
            Ok(most)
        };
        let threads = thread::available_parallelism().map_or(1, usize::from).min(MOST_THREADS);
        let most = thread::scope(|scope| {
            // Whatever others there are, this thread does what is left. A decoder may panic over damage.
            let spawn = |_| thread::Builder::new().name("luxel preview".into()).spawn_scoped(scope, work).ok();
            let others: Vec<_> = (0..threads).filter_map(spawn).collect();
            let own = if others.is_empty() { work() } else { Ok(0.0) };
            let joined = others.into_iter().map(|other| other.join().unwrap_or(Err(Fault::Broken)));
            joined.chain([own]).try_fold(0.0f32, |most, light| Ok(most.max(light?)))
        })?;
        if filled.into_inner() == height { Ok((texels, most)) } else { Err(Fault::Broken) }
    }

    /// Decodes some rows; returns how many, and the most light in them.
    fn block(&self, chunk: &Chunk, rows: &[Mutex<&mut [u8]>], scale: f32) -> Result<(usize, f32), Fault> {
        let channels = &self.header.channels;
        let block = UncompressedBlock::decompress_chunk(chunk.clone(), self.meta, false).map_err(|_| Fault::Broken)?;
        let (mut count, mut most) = (0, 0.0f32);
        let mut values: Vec<Vec<f32>> = vec![Vec::new(); channels.list.len()];
        for line in block.lines(channels) {
            let (channel, position) = (line.location.channel, line.location.position);
            let (Some(into), Some(of)) = (values.get_mut(channel), channels.list.get(channel)) else { break };
            floats(line.value, of.sample_type, into);
            if channel + 1 == channels.list.len() {
                let row = rows.get(position.y()).ok_or(Fault::Broken)?;
                let row = &mut *row.lock().unwrap_or_else(PoisonError::into_inner);
                if position.x() != 0 || values.iter().any(|v| v.len() * TEXEL != row.len()) {
                    return Err(Fault::Broken);
                }
                most = most.max(self.row(&values, row, scale));
                count += 1;
            }
        }
        Ok((count, most))
    }

    /// Writes a row; returns the most light in it.
    fn row(&self, values: &[Vec<f32>], row: &mut [u8], scale: f32) -> f32 {
        let [r, g, b, a] = self.channels.map(|channel| &values[channel][..]);
        let buried = self.buried.map(|channel| &values[channel][..]);
        let mut most = 0.0f32;
        for (x, texel) in row.chunks_exact_mut(TEXEL).enumerate() {
            let sign = if buried.is_some_and(|buried| buried[x] > 0.5) { -1.0 } else { 1.0 };
            let light = [r[x], g[x], b[x]];
            most = light.into_iter().filter(|e| e.is_finite()).fold(most, f32::max);
            let [r, g, b] = light.map(|e| if e > 0.0 { (e / scale).min(MAX_HALF) } else { 0.0 });
            let values = [r, g, b, sign * a[x].clamp(0.0, 1.0)];
            texel.copy_from_slice(values.map(|v| f16::from_f32(v).to_le_bytes()).as_flattened());
        }
        most
    }
}

/// The values of a line, in the order of bytes of this machine.
fn floats(bytes: &[u8], kind: SampleType, values: &mut Vec<f32>) {
    values.clear();
    let (pairs, _) = bytes.as_chunks();
    let (words, _) = bytes.as_chunks();
    match kind {
        SampleType::F16 => values.extend(pairs.iter().map(|b| f16::from_ne_bytes(*b).to_f32())),
        SampleType::F32 => values.extend(words.iter().map(|b| f32::from_ne_bytes(*b))),
        SampleType::U32 => values.extend(words.iter().map(|b| u32::from_ne_bytes(*b) as f32)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use luxel_export::{Depth, Lightmap, openexr::Exr};

    fn encoded(map: &Lightmap, depth: Depth) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        Exr::lightmap(map, depth, "k").unwrap().write(&mut bytes).unwrap();
        bytes.into_inner()
    }

    fn exr(e: Vec<Vec3>, coverage: Vec<f32>) -> Vec<u8> {
        encoded(&Lightmap::new(2, (e.len() / 2) as u32, e, coverage).unwrap(), Depth::Float)
    }

    /// Width, height, scale, and the numbers of all texels.
    fn read_back(bytes: &[u8]) -> (u32, u32, f32, Vec<f32>) {
        let word = |i: usize| <[u8; 4]>::try_from(&bytes[4 * i..4 * i + 4]).unwrap();
        let halves = bytes[16..].chunks_exact(2).map(|h| f16::from_le_bytes([h[0], h[1]]).to_f32());
        (u32::from_le_bytes(word(0)), u32::from_le_bytes(word(1)), f32::from_le_bytes(word(2)), halves.collect())
    }

    #[test]
    fn texels_come_back_in_their_order() {
        let e: Vec<Vec3> = (0..4).map(|i| Vec3::new(i as f32, 0.5, 1024.0)).collect();
        let texels = decode(&exr(e, vec![1.0, 0.5, 0.0, 0.25])).unwrap();
        let (width, height, scale, numbers) = read_back(&texels);
        assert_eq!((width, height, scale), (2, 2, 1.0));
        let expected =
            [[0.0, 0.5, 1024.0, 1.0], [1.0, 0.5, 1024.0, 0.5], [2.0, 0.5, 1024.0, 0.0], [3.0, 0.5, 1024.0, 0.25]];
        assert_eq!(numbers, expected.concat());
    }

    #[test]
    fn buried_texels_have_negative_coverage() {
        let map = Lightmap::new(2, 2, vec![Vec3::ONE; 4], vec![1.0, 0.5, 1.0, 0.0]).unwrap();
        let bytes = encoded(&map.with_buried([2, 1]).unwrap(), Depth::Half);
        let (_, _, _, numbers) = read_back(&decode(&bytes).unwrap());
        let cover: Vec<f32> = numbers.into_iter().skip(3).step_by(4).collect();
        assert_eq!(cover, [1.0, -0.5, -1.0, 0.0]);
    }

    #[test]
    fn light_beyond_half_floats_is_scaled() {
        for max in [1e5, 3e38] {
            let (_, _, scale, numbers) =
                read_back(&decode(&exr(vec![Vec3::splat(max), Vec3::splat(0.5 * max)], vec![1.0; 2])).unwrap());
            for (k, expected) in [(0, max), (4, 0.5 * max)] {
                let found = numbers[k] * scale;
                assert!((found / expected - 1.0).abs() < 1e-3, "{found} {expected}");
            }
        }
    }

    #[test]
    fn a_picture_beyond_the_limit_is_told_from_a_broken_one() {
        let mut bytes = exr(vec![Vec3::ONE; 2], vec![1.0; 2]);
        // The data window, whose last two numbers are the largest x and y.
        let name = b"dataWindow\0box2i\0";
        let window = bytes.windows(name.len()).position(|w| w == name).unwrap() + name.len() + 4;
        bytes[window + 8..window + 16].copy_from_slice([16_383u32.to_le_bytes(); 2].as_flattened());
        assert_eq!(decode(&bytes), Err(Fault::Large));
    }

    #[test]
    fn damage_is_an_error_and_no_panic() {
        let whole = exr(vec![Vec3::ONE; 2], vec![1.0; 2]);
        for cut in (0..whole.len()).step_by(3) {
            assert!(decode(&whole[..cut]).is_err(), "{cut}");
        }
        for i in 0..whole.len() {
            let mut bytes = whole.clone();
            bytes[i] ^= 0x5a;
            // Whether the change shows depends on where it is.
            let _ = decode(&bytes);
        }
        assert_eq!(decode(b"no exr"), Err(Fault::Broken));
    }
}
