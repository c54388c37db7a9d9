// Memory for large arrays that are walked in no order: on huge pages where the system lets a program ask for them (Linux,
// madvise). A gather over 100,000 grains touches some ten thousand pages of 4 kB, far more than a core's table of pages
// holds; in pages of 2 MB they are a dozen.
#pragma once
#include <cstddef>
#include <cstdlib>
#include <new>
#include <vector>

#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace lockstep {

// Small arrays and other systems: plain aligned memory. Never fails where that does not.
template <class T>
struct HugePages {
  using value_type = T;
  static constexpr std::size_t page = std::size_t{1} << 21;  // [bytes]

  HugePages() = default;
  template <class U>
  HugePages(const HugePages<U>&) {}  // NOLINT: allocators convert

  T* allocate(std::size_t count) {
    const std::size_t bytes = count * sizeof(T);
    if (bytes < page) return static_cast<T*>(::operator new(bytes, std::align_val_t(alignof(T))));
    void* const memory = std::aligned_alloc(page, (bytes + page - 1) / page * page);
    if (!memory) throw std::bad_alloc();
#if defined(__linux__) && defined(MADV_HUGEPAGE)
    ::madvise(memory, (bytes + page - 1) / page * page, MADV_HUGEPAGE);  // a wish: without it the pages are small
#endif
    return static_cast<T*>(memory);
  }

  void deallocate(T* memory, std::size_t count) {
    if (count * sizeof(T) < page)
      ::operator delete(memory, std::align_val_t(alignof(T)));
    else
      std::free(memory);
  }

  template <class U>
  bool operator==(const HugePages<U>&) const {
    return true;
  }
};

template <class T>
using LargeArray = std::vector<T, HugePages<T>>;

}  // namespace lockstep
