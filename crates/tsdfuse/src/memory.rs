//! Asking for memory before it is needed. The only `unsafe` of this crate.

/// Tells the CPU that a value will soon be changed, so that it fetches the value's cache line meanwhile. A hint; does nothing on
/// CPUs for which no instruction is known here.
#[allow(unsafe_code)]
#[inline(always)]
pub(crate) fn prefetch<T>(value: &T) {
    // SAFETY: the instruction reads and writes nothing and never faults, whatever the address; this one is a reference's.
    #[cfg(target_arch = "x86_64")]
    unsafe {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(value).cast());
    }
    // SAFETY: as above; it has no operands but the address and changes no flags and no memory.
    #[cfg(target_arch = "aarch64")]
    unsafe {
        std::arch::asm!("prfm pstl1keep, [{}]", in(reg) std::ptr::from_ref(value), options(nostack, readonly, preserves_flags));
    }
    #[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
    let _ = value;
}
