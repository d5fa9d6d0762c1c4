// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/files/zip.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <vector>

#include <minizip/unzip.h>
#include <minizip/zip.h>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/files/unfinished.h"

namespace redrive {
namespace {

constexpr std::size_t kMostMembers = 100'000, kMostName = 4096;
constexpr std::size_t kBlock = std::size_t{1} << 20;

/// Returns the extra field that lets a member's bytes begin at a multiple of 64. `offset`: where
/// they begin without it. 0x1986 is the field that USDZ's writers pad with.
std::string padding(std::uint64_t offset) {
  constexpr std::size_t kAlignment = 64, kField = 4;
  const std::size_t past = (offset + kField) % kAlignment, zeros = past > 0 ? kAlignment - past : 0;
  return std::string{'\x86', '\x19', static_cast<char>(zeros), '\0'} + std::string(zeros, '\0');
}

}  // namespace

void write_zip(const std::filesystem::path& path, std::span<const ZipMember> members) {
  UnfinishedFile file(path);
  const zipFile zip = zipOpen64(file.path().c_str(), APPEND_STATUS_CREATE);
  errno = 0;  // minizip tells no reason of its own
  bool good = zip != nullptr;
  zip_fileinfo info{};
  info.tmz_date.tm_year = 1980;  // the format's first day
  info.tmz_date.tm_mday = 1;
  std::uint64_t offset = 0;
  for (const ZipMember& member : members) {
    if (!good) break;
    const bool large = member.bytes.size() >= 0xffffffff;
    constexpr int kStored = 0;
    constexpr std::size_t kHeader = 30, kLargeSizes = 20;
    offset += kHeader + member.name.size() + (large ? kLargeSizes : 0);
    const std::string extra = padding(offset);
    good = zipOpenNewFileInZip64(zip, member.name.c_str(), &info, extra.data(),
                                 static_cast<unsigned>(extra.size()), nullptr, 0, nullptr, kStored,
                                 0, large) == ZIP_OK;
    offset += extra.size() + member.bytes.size();
    for (std::string_view rest = member.bytes; good && !rest.empty();) {
      const auto n = static_cast<unsigned>(std::min(rest.size(), kBlock));
      good = zipWriteInFileInZip(zip, rest.data(), n) == ZIP_OK;
      rest.remove_prefix(n);
    }
    good = good && zipCloseFileInZip(zip) == ZIP_OK;
  }
  if (zip && zipClose(zip, nullptr) != ZIP_OK) good = false;
  if (!good)
    throw IoError(path, std::string("cannot write: ") +
                            (errno != 0 ? std::strerror(errno) : "minizip refuses a member"));
  file.finish();
}

ZipFile::ZipFile(const std::filesystem::path& path) : path_(path) {
  const auto fail = [&](const char* rule) { throw InputError(path, "", "", rule); };
  if (!read_head(path, 2).starts_with("PK")) fail("is no zip");
  zip_ = std::shared_ptr<void>(unzOpen64(path.c_str()), [](void* zip) {
    if (zip) unzClose(zip);
  });
  if (!zip_) fail("is a damaged zip: it has no directory of members");
  std::size_t count = 0;
  int at = unzGoToFirstFile(zip_.get());
  for (; at == UNZ_OK; at = unzGoToNextFile(zip_.get())) {
    if (++count > kMostMembers) fail("has more than 100000 members");
    std::vector<char> name(kMostName + 1, '\0');
    unz_file_info64 info{};
    unz64_file_pos place{};
    if (unzGetCurrentFileInfo64(zip_.get(), &info, name.data(), kMostName, nullptr, 0, nullptr,
                                0) != UNZ_OK ||
        info.size_filename > kMostName || unzGetFilePos64(zip_.get(), &place) != UNZ_OK)
      fail("is a damaged zip: a member has no usable name");
    members_[name.data()] = {place.pos_in_zip_directory, place.num_of_file, info.uncompressed_size,
                             (info.flag & 1) != 0};
  }
  if (at != UNZ_END_OF_LIST_OF_FILE) fail("is a damaged zip: its directory of members is cut off");
}

std::vector<std::string> ZipFile::names() const {
  std::vector<std::string> names;
  for (const auto& [name, member] : members_) names.push_back(name);
  return names;
}

const ZipFile::Member* ZipFile::find(const std::filesystem::path& path) const {
  const std::string root = (path_ / "").string();
  if (!path.native().starts_with(root)) return nullptr;
  const auto found = members_.find(path.native().substr(root.size()));
  return found == members_.end() ? nullptr : &found->second;
}

std::optional<std::uint64_t> ZipFile::size(const std::filesystem::path& path) const {
  const Member* const member = find(path);
  return member ? std::optional(member->bytes) : std::nullopt;
}

std::string ZipFile::read(const std::filesystem::path& path, std::size_t most) const {
  const Member* const member = find(path);
  const auto fail = [&](const char* rule) { throw InputError(path, "", "", rule); };
  if (!member) fail("the zip has no such member");
  if (member->encrypted) fail("is encrypted");
  const std::lock_guard lock(mutex_);
  const unz64_file_pos place{member->offset, member->number};
  if (unzGoToFilePos64(zip_.get(), &place) != UNZ_OK || unzOpenCurrentFile(zip_.get()) != UNZ_OK)
    fail("is a damaged member, or compressed by another method than deflate");
  // Memory follows the bytes that are there, not the size that the zip claims.
  std::string bytes;
  const std::uint64_t wanted = std::min<std::uint64_t>(most, member->bytes);
  int got = 1;
  while (bytes.size() < wanted && got > 0) {
    const std::size_t have = bytes.size();
    bytes.resize(have + std::min<std::uint64_t>(kBlock, wanted - have));
    got = unzReadCurrentFile(zip_.get(), bytes.data() + have,
                             static_cast<unsigned>(bytes.size() - have));
    bytes.resize(have + static_cast<std::size_t>(std::max(got, 0)));
  }
  const bool whole = unzCloseCurrentFile(zip_.get()) != UNZ_CRCERROR;
  if (got < 0 || bytes.size() < wanted || (wanted == member->bytes && !whole))
    fail("is a damaged member");
  return bytes;
}

}  // namespace redrive
