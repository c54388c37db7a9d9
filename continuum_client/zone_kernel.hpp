// K u without K: the forces of eight one-point zones at a time from the shape of each, with nothing stored but where its
// nodes are: 50 bytes a zone to read instead of the assembled operator's 1,150. Compiled once for each instruction set,
// with the same bits.
//
// Rejected: the same for mixed discretization, whose ten tetrahedra are so much arithmetic that reading the operator from
// memory is cheaper (0.107 us a zone against 0.086).
#pragma once
#include <cstdint>

#include "continuum_client/zone_blocks.hpp"

namespace lockstep::continuum {

// f += forces of `count` blocks whose nodes stand at x and are displaced by u, node i at f.x[i - f_begin] and so on.
// `moduli`: per block eight shear, then eight bulk moduli. Eight entries beyond the last node of x and u may be read.
using ZoneKernel = void (*)(const ZoneBlock* blocks, std::int32_t count, const std::int32_t* tables,
                            const double* moduli, const Components& x, const Components& u, const Components& f,
                            std::int32_t f_begin);

ZoneKernel zone_kernel_generic();
ZoneKernel zone_kernel_avx2();
ZoneKernel zone_kernel_avx512();

}  // namespace lockstep::continuum
