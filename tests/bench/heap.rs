//! Bytes that are allocated at once.

use std::{
    alloc::{GlobalAlloc, Layout, System},
    sync::atomic::{AtomicUsize, Ordering::Relaxed},
};

static NOW: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

/// The system's allocator with a count of the bytes that are in use.
pub struct Counting;

fn grow(bytes: usize) {
    PEAK.fetch_max(NOW.fetch_add(bytes, Relaxed) + bytes, Relaxed);
}

fn shrink(bytes: usize) {
    NOW.fetch_sub(bytes, Relaxed);
}

// SAFETY: every call is passed on to the system's allocator as it came; counting does not touch the memory.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        grow(layout.size());
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        grow(layout.size());
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        shrink(layout.size());
        unsafe { System.dealloc(memory, layout) }
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // Old and new may live side by side while the content moves; where pages are remapped this counts too much.
        grow(size);
        let moved = unsafe { System.realloc(memory, layout, size) };
        shrink(layout.size());
        moved
    }
}

/// Bytes that are in use now, and the most that were at once since the last lap.
pub fn lap() -> (usize, usize) {
    let now = NOW.load(Relaxed);
    (now, PEAK.swap(now, Relaxed))
}

/// Runs the work; returns its result and the most bytes that it held at once beyond what was there before.
pub fn peak_bytes<T>(work: impl FnOnce() -> T) -> (T, usize) {
    let (before, _) = lap();
    let result = work();
    (result, lap().1.saturating_sub(before))
}
