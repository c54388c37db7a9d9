// CRC-32 as in zlib, PNG and Ethernet (polynomial 0x04c11db7, reflected, all ones at both ends), with carry-less
// multiplication where the processor has it: several times faster than zlib 1.2.13 on a frame of 18 kB, four of which
// are checked in a time step.
#pragma once
#include <cstddef>
#include <cstdint>
#include <span>

namespace lockstep::protocol {

std::uint32_t crc32(std::span<const std::byte> bytes);

}  // namespace lockstep::protocol
