#include "common/log.hpp"

#include <spdlog/sinks/basic_file_sink.h>
#include <spdlog/sinks/stdout_color_sinks.h>

#include <cstdio>
#include <memory>
#include <vector>

#include "common/checks.hpp"

namespace lockstep {

void start_log(const std::string& program, const std::filesystem::path& file, bool verbose) {
  std::vector<spdlog::sink_ptr> sinks;
  sinks.push_back(std::make_shared<spdlog::sinks::stderr_color_sink_mt>());
  sinks.back()->set_level(verbose ? spdlog::level::debug : spdlog::level::info);
  if (!file.empty()) {
    try {
      sinks.push_back(std::make_shared<spdlog::sinks::basic_file_sink_mt>(file.string(), true));
    } catch (const spdlog::spdlog_ex& e) {
      throw IoError(fmt::format("{}: cannot write the log: {}; give another --log", file.string(), e.what()));
    }
    sinks.back()->set_level(spdlog::level::debug);
  }
  auto logger = std::make_shared<spdlog::logger>(program, sinks.begin(), sinks.end());
  logger->set_level(spdlog::level::debug);
  logger->set_pattern("[%H:%M:%S.%e] [%n] [%l] %v");
  // A process that is killed leaves its last words behind.
  logger->flush_on(spdlog::level::info);
  spdlog::set_default_logger(logger);
}

void print_progress(const std::string& key_values) {
  const std::string line = "@progress " + key_values + "\n";
  std::fwrite(line.data(), 1, line.size(), stdout);
  std::fflush(stdout);
}

}  // namespace lockstep
