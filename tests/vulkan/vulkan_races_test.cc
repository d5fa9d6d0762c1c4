// SPDX-License-Identifier: Apache-2.0
// Shared memory of the shaders: no two threads of a group touch a word between the same barriers,
// one of them writing (shaders/races.glsl), and without any one of the barriers some do.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <map>
#include <random>
#include <sstream>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/kernels/backend.h"
#include "redrive/kernels/gaussian/gaussian_stages.h"
#include "redrive/kernels/gaussian/vulkan/shaders.h"
#include "redrive/kernels/vulkan/vulkan_api.h"
#include "tests/support/program.h"

namespace redrive::kernels {
namespace {

namespace fs = std::filesystem;
using vulkan::Api;

const fs::path kShaders = fs::path(REDRIVE_SOURCE) / "src/redrive/kernels/gaussian/vulkan/shaders";

/// A shader whose threads share memory, as the build makes it.
struct Job {
  const char *name, *source;
  std::vector<std::string> defines = {};
};
const std::vector<Job>& jobs() {
  static const std::vector<Job> all = {{"tile_forward", "tile_forward.comp"},
                                       {"tile_backward", "tile_backward.comp"},
                                       {"tile_parts", "tile_parts.comp"},
                                       {"sum_pairs", "sum_pairs.comp"},
                                       {"pose_sums", "pose_sums.comp"},
                                       {"scan0", "scan.comp", {"PASS=0"}},
                                       {"scan1", "scan.comp", {"PASS=1"}},
                                       {"scan2", "scan.comp", {"PASS=2"}},
                                       {"flags0", "scan.comp", {"PASS=0", "FLAGS"}},
                                       {"flags1", "scan.comp", {"PASS=1", "FLAGS"}},
                                       {"flags2", "scan.comp", {"PASS=2", "FLAGS"}},
                                       {"sort0", "sort.comp", {"SCATTER=0"}},
                                       {"sort1", "sort.comp", {"SCATTER=1"}},
                                       {"pairs0", "pairs.comp", {"EMIT=0"}},
                                       {"pairs1", "pairs.comp", {"EMIT=1"}},
                                       {"loss0", "loss.comp", {"PASS=0"}},
                                       {"loss_sums", "loss_sums.comp"},
                                       {"loss1", "loss.comp", {"PASS=1"}},
                                       {"score0", "score.comp", {"PASS=0"}},
                                       {"score1", "score.comp", {"PASS=1"}},
                                       {"score2", "score.comp", {"PASS=2"}}};
  return all;
}

using Words = std::vector<std::uint32_t>;

std::string text_of(const fs::path& file) {
  std::ostringstream text;
  text << std::ifstream(file).rdbuf();
  return text.str();
}

/// Compiles a shader of `sources` so that it notes its accesses.
Words compile(const Job& job, const fs::path& sources) {
  const fs::path out = sources / (std::string(job.name) + ".spv");
  std::vector<std::string> arguments = {"--quiet", "-V", "--target-env", "vulkan1.2", "-DRACES"};
  for (const std::string& define : job.defines) arguments.push_back("-D" + define);
  for (const fs::path& folder : {sources, fs::path(REDRIVE_GLSL)})
    arguments.push_back("-I" + folder.string());
  arguments.insert(arguments.end(), {"-o", out.string(), (sources / job.source).string()});
  const testing::ProgramResult result = testing::Program(REDRIVE_GLSLANG, arguments).wait();
  EXPECT_EQ(result.exit_code, 0) << result.out;
  const std::string bytes = text_of(out);
  Words words(bytes.size() / 4);
  std::memcpy(words.data(), bytes.data(), 4 * words.size());
  return words;
}

/// Gives devices other shaders, and each dispatch a clear memory in which they note accesses.
class Noting {
 public:
  explicit Noting(const std::map<std::string, Words>& instead) : instead_(instead) {
    current_ = this;
    vulkan::wrap_api = [](Api* api) { current_->install(api); };
  }
  ~Noting() { vulkan::wrap_api = nullptr; }
  Noting(const Noting&) = delete;
  Noting& operator=(const Noting&) = delete;

  int races = 0;  ///< noted by devices that were closed

 private:
  // Of races.glsl: 64 groups, and the words before theirs.
  static constexpr VkDeviceSize kBytes = 4 * (16 + 64 * 65536);

  void install(Api* api) {
    if (!api->CreateBuffer) return;  // the instance's table
    inner_ = *api;
    api->CreateCommandPool = [](auto device, auto info, auto callbacks, auto pool) {
      current_->open(device);
      return current_->inner_.CreateCommandPool(device, info, callbacks, pool);
    };
    api->DestroyCommandPool = [](auto device, auto pool, auto callbacks) {
      current_->inner_.DestroyCommandPool(device, pool, callbacks);
      current_->close(device);
    };
    api->CreateShaderModule = [](auto device, auto info, auto callbacks, auto module) {
      VkShaderModuleCreateInfo other = *info;
      for (const vulkan::Shader& shader : gaussian_shaders())
        if (shader.words.data() == info->pCode)
          if (const auto found = current_->instead_.find(std::string(shader.name));
              found != current_->instead_.end()) {
            other.pCode = found->second.data();
            other.codeSize = 4 * found->second.size();
          }
      return current_->inner_.CreateShaderModule(device, &other, callbacks, module);
    };
    api->CmdPushConstants = [](auto commands, auto layout, auto stages, auto at, auto size,
                               auto values) {
      const auto push = current_->inner_.CmdPushConstants;
      push(commands, layout, stages, at, size, values);
      push(commands, layout, stages, 112, 8, &current_->address_);
    };
    api->CmdDispatch = [](auto commands, auto x, auto y, auto z) {
      EXPECT_LE(x, 64u) << "groups that note accesses";
      current_->clear(commands);
      current_->inner_.CmdDispatch(commands, x, y, z);
    };
    api->CmdDispatchIndirect = [](auto commands, auto buffer, auto at) {
      current_->clear(commands);
      current_->inner_.CmdDispatchIndirect(commands, buffer, at);
    };
  }
  void clear(VkCommandBuffer commands) {
    inner_.CmdFillBuffer(commands, buffer_, 64, kBytes - 64, 0);
    VkMemoryBarrier all{VK_STRUCTURE_TYPE_MEMORY_BARRIER};
    all.srcAccessMask = VK_ACCESS_TRANSFER_WRITE_BIT;
    all.dstAccessMask = VK_ACCESS_SHADER_READ_BIT | VK_ACCESS_SHADER_WRITE_BIT;
    inner_.CmdPipelineBarrier(commands, VK_PIPELINE_STAGE_TRANSFER_BIT,
                              VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT, 0, 1, &all, 0, nullptr, 0,
                              nullptr);
  }
  void open(VkDevice device) {
    VkBufferCreateInfo info{VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO};
    info.size = kBytes;
    info.usage = VK_BUFFER_USAGE_STORAGE_BUFFER_BIT | VK_BUFFER_USAGE_TRANSFER_DST_BIT |
                 VK_BUFFER_USAGE_SHADER_DEVICE_ADDRESS_BIT;
    ASSERT_EQ(inner_.CreateBuffer(device, &info, nullptr, &buffer_), VK_SUCCESS);
    VkMemoryRequirements needs;
    inner_.GetBufferMemoryRequirements(device, buffer_, &needs);
    VkMemoryAllocateFlagsInfo flags{VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_FLAGS_INFO};
    flags.flags = VK_MEMORY_ALLOCATE_DEVICE_ADDRESS_BIT;
    VkMemoryAllocateInfo allocate{VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO};
    allocate.pNext = &flags;
    allocate.allocationSize = needs.size;  // type 0: a software device has one, which the host sees
    ASSERT_EQ(inner_.AllocateMemory(device, &allocate, nullptr, &memory_), VK_SUCCESS);
    ASSERT_EQ(inner_.BindBufferMemory(device, buffer_, memory_, 0), VK_SUCCESS);
    void* at = nullptr;
    ASSERT_EQ(inner_.MapMemory(device, memory_, 0, VK_WHOLE_SIZE, 0, &at), VK_SUCCESS);
    noted_ = static_cast<std::uint32_t*>(at);
    std::memset(noted_, 0, kBytes);
    VkBufferDeviceAddressInfo address{VK_STRUCTURE_TYPE_BUFFER_DEVICE_ADDRESS_INFO};
    address.buffer = buffer_;
    address_ = inner_.GetBufferDeviceAddress(device, &address);
  }
  void close(VkDevice device) {
    races += static_cast<int>(noted_[0]);
    inner_.DestroyBuffer(device, buffer_, nullptr);
    inner_.FreeMemory(device, memory_, nullptr);
  }

  static inline Noting* current_ = nullptr;
  const std::map<std::string, Words>& instead_;
  Api inner_;
  VkBuffer buffer_ = VK_NULL_HANDLE;
  VkDeviceMemory memory_ = VK_NULL_HANDLE;
  VkDeviceAddress address_ = 0;
  std::uint32_t* noted_ = nullptr;
};

/// Scores an image, and trains Gaussians for a step with all that a step can have: more than 256 of
/// them meet a tile, and some meet more than 32 tiles.
int races_of_a_step(const std::map<std::string, Words>& instead) {
  constexpr std::size_t kCount = 600;
  Noting noting(instead);
  try {
    const auto backend = make_vulkan_backend("0", 1);
    std::mt19937 random(5);
    const auto next = [&] { return std::ldexp(static_cast<float>(random() >> 8), -23) - 1; };
    PlainCamera camera;
    camera.fx = camera.fy = 140;
    camera.cx = 56;
    camera.cy = 48;
    camera.width = 112;
    camera.height = 96;
    std::vector<float> numbers(gaussian_blocks(kCount) * kBlockSize);
    for (std::size_t i = 0; i < kCount; ++i) {
      const auto number = [&](int row) -> float& { return numbers[gaussian_slot(i, row)]; };
      for (int row = 0; row < kGaussianRows; ++row) number(row) = next();
      number(kPositionRow) *= 0.5f;
      number(kPositionRow + 1) *= 0.5f;
      number(kPositionRow + 2) += 4;
      for (int k = 0; k < 3; ++k) number(kLogScaleRow + k) += i < 40 ? 1.5f : -2.0f;
      number(kOpacityRow) -= 4;
    }
    const std::size_t plane = raster_size(camera.width, camera.height).plane();
    const std::array<PlainPose, 1> pose{};
    const std::array<GaussianPart, 2> parts{{{16, pose}, {24, pose}}};
    const std::vector<float> ranges(plane, 1.3f);
    const std::vector<std::uint8_t> target(3 * 112 * 96, 99);
    Raster raster = backend->gaussians().rasterise(
        {.camera = camera, .world_from_camera = pose, .image_rows = 96, .parts = parts},
        {kCount, numbers}, {.parts = true, .log_range = ranges});
    ImageLossInput input;
    input.target = {.width = camera.width, .rgb = target};
    std::vector<float> gradients(numbers.size()), errors(numbers.size() / kGaussianRows);
    std::array<GaussianPoseGradient<NumberMath<double>>, 3> d_pose;
    raster.backward(input, {.transmittance = 0.02f, .range = 0.01f},
                    {.gradients = gradients, .errors = errors}, d_pose);
    const std::vector<float> rgb(target.size(), 0.5f);
    backend->score({camera.width, camera.height, rgb, target, {}});
    EXPECT_GT(raster.counts().pairs, 6u * 256);
    EXPECT_LE(raster.counts().visible, 1024u) << "sum_pairs has a group for 16";
  } catch (const DeviceError& error) {  // a race may ask for any amount of memory
    EXPECT_GT(noting.races, 0) << error.what();
  }
  return noting.races;
}

class VulkanRaces : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string reason;
    try {
      if (make_vulkan_backend("0", 1)->device().find("llvmpipe") == std::string::npos)
        reason = "the first device is not llvmpipe";
    } catch (const UsageError& error) {
      reason = error.what();
    }
    if (!reason.empty()) GTEST_SKIP() << reason;
    fs::copy(kShaders, folder_.path / "shaders");
  }
  /// Returns the races in the shaders that a file is part of.
  int races_of(const std::string& file) const {
    std::map<std::string, Words> noting;
    for (const Job& job : jobs())
      if (job.source == file || (file == "scan.glsl" && includes_scan(job)))
        noting[job.name] = compile(job, folder_.path / "shaders");
    EXPECT_FALSE(noting.empty()) << file << " is part of no shader in jobs()";
    return races_of_a_step(noting);
  }
  static bool includes_scan(const Job& job) {
    return text_of(kShaders / job.source).find("\"scan.glsl\"") != std::string::npos;
  }
  const std::string kBarrier = "sync();";
  TemporaryFolder folder_;
};

/// In a process that the next test starts: REDRIVE_BARRIER is a file and where a barrier in it is
/// left out, or its end.
TEST_F(VulkanRaces, ChildNotesNone) {
  const char* const barrier = std::getenv("REDRIVE_BARRIER");
  if (!barrier) return;
  std::string file;
  std::size_t at = 0;
  std::istringstream(barrier) >> file >> at;
  const fs::path path = folder_.path / "shaders" / file;
  const std::string text = text_of(path);
  if (at < text.size())
    std::ofstream(path) << text.substr(0, at) << text.substr(at + kBarrier.size());
  EXPECT_EQ(races_of(file), 0);
}

/// Without a barrier anything may happen, so each one is left out in a process of its own.
class VulkanBarriers : public VulkanRaces, public ::testing::WithParamInterface<std::string> {
 protected:
  static bool is_right(const std::string& file, std::size_t at) {
    setenv("REDRIVE_BARRIER", (file + " " + std::to_string(at)).c_str(), 1);
    const auto child =
        testing::Program("/proc/self/exe", {"--gtest_filter=VulkanRaces.ChildNotesNone"}).wait();
    unsetenv("REDRIVE_BARRIER");
    return child.exit_code == 0;
  }
};

TEST_P(VulkanBarriers, AreThereAndNeeded) {
  const std::string file = GetParam(), text = text_of(kShaders / file);
  EXPECT_TRUE(is_right(file, text.size()));
  int number = 0;
  for (std::size_t at = text.find(kBarrier); at != std::string::npos;
       at = text.find(kBarrier, at + 1)) {
    // The last one of scan.glsl is for a second round, which 524,288 numbers have.
    if (++number == 4 && file == "scan.glsl") continue;
    EXPECT_FALSE(is_right(file, at))
        << file << ":" << 1 + std::count(text.begin(), text.begin() + std::ptrdiff_t(at), '\n');
  }
  EXPECT_GT(number, 0);
}

const std::vector<std::string>& files_with_barriers() {
  static const std::vector<std::string> all = {
      "loss.comp",          "loss_sums.comp",    "pairs.comp",     "pose_sums.comp",
      "scan.glsl",          "score.comp",        "sort.comp",      "sum_pairs.comp",
      "tile_backward.comp", "tile_forward.comp", "tile_parts.comp"};
  return all;
}
INSTANTIATE_TEST_SUITE_P(Shaders, VulkanBarriers, ::testing::ValuesIn(files_with_barriers()),
                         [](const auto& info) {
                           return info.param.substr(0, info.param.find('.'));
                         });

TEST(VulkanShaders, AllWithBarriersAreTested) {
  for (const auto& entry : fs::directory_iterator(kShaders)) {
    const std::string file = entry.path().filename();
    if (file == "races.glsl" || text_of(entry.path()).find("sync();") == std::string::npos)
      continue;
    EXPECT_EQ(std::ranges::count(files_with_barriers(), file), 1) << file;
  }
}

}  // namespace
}  // namespace redrive::kernels
