// Logging: one line an event to the console and, in full, to a file. spdlog does the work.
#pragma once
#include <spdlog/spdlog.h>

#include <filesystem>
#include <string>

namespace lockstep {

// `program` stands in each line; `file` may be empty. Console shows info and above, or all with `verbose`.
void start_log(const std::string& program, const std::filesystem::path& file, bool verbose);

// Machine-readable progress for tools/run: one line "@progress key=value ..." on standard output.
// Keys: side, stage, fraction, step, time, and what the stage knows (sd, tip_kpa, ...).
void print_progress(const std::string& key_values);

}  // namespace lockstep
