// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/files/zip.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/files/temporary_folder_testing.h"

namespace redrive {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

class Zip : public ::testing::Test {
 protected:
  std::string large_ = std::string(3'000'000, 'x') + "end";
  TemporaryFolder folder_;
  const std::filesystem::path file_ = folder_.path / "a.usdz";

  void write() const {
    write_zip(file_, std::vector<ZipMember>{{"b/text", "words"}, {"a", large_}, {"empty", ""}});
  }
  std::string error() const {
    try {
      const ZipFile zip(file_);
      for (const std::string& name : zip.names()) zip.read(file_ / name, kMaxDataBytes);
    } catch (const InputError& error) {
      return error.what();
    }
    return "";
  }
};

TEST_F(Zip, GivesBackWhatWasWritten) {
  write();
  const std::string bytes = read_file(file_);
  write();
  EXPECT_EQ(read_file(file_), bytes) << "equal members give other files";
  EXPECT_THAT(bytes, HasSubstr("words"));
  EXPECT_LT(bytes.size(), large_.size() + 1000) << "members are stored";
  for (const std::string begin : {"words", "xxx"})
    EXPECT_EQ(bytes.find(begin) % 64, 0u) << "as USDZ asks";
  mount(file_, std::make_shared<ZipFile>(file_));
  EXPECT_EQ(read_file(file_ / "b/text"), "words");
  EXPECT_EQ(read_file(file_ / "a"), large_);
  EXPECT_EQ(read_file(file_ / "empty"), "");
  EXPECT_EQ(read_head(file_ / "b/text", 3), "wor");
  EXPECT_EQ(file_bytes(file_ / "a"), large_.size());
  EXPECT_EQ(file_bytes(file_ / "b"), std::nullopt);
  EXPECT_THROW(read_file(file_ / "c"), InputError);
  EXPECT_THROW(read_file(file_ / "a", 1000), InputError) << "larger than allowed";
  EXPECT_THAT(ZipFile(file_).names(), ElementsAre("a", "b/text", "empty"));
}

TEST_F(Zip, ReadsWhatOtherProgramsCompressed) {
  folder_.write("long", large_);
  ASSERT_EQ(std::system(("cd " + folder_.path.string() +
                         " && python3 -c 'import zipfile\n"
                         "with zipfile.ZipFile(\"a.usdz\", \"w\", zipfile.ZIP_DEFLATED) as z: "
                         "z.write(\"long\"); z.writestr(\"../up\", \"u\")'")
                            .c_str()),
            0);
  EXPECT_LT(std::filesystem::file_size(file_), 100'000);
  const ZipFile zip(file_);
  EXPECT_EQ(zip.read(file_ / "long", kMaxDataBytes), large_);
  EXPECT_THAT(zip.names(), ElementsAre("../up", "long"));
}

TEST_F(Zip, RefusesWhatIsDamaged) {
  write();
  const std::string whole = read_file(file_);
  for (const std::size_t cut : {whole.size() - 30, whole.size() / 2, size_t{3}}) {
    write_file(file_, whole.substr(0, cut));
    EXPECT_THAT(error(), HasSubstr("damaged zip")) << cut;
  }
  write_file(file_, "no zip");
  EXPECT_THAT(error(), HasSubstr("is no zip"));
  std::string changed = whole;
  changed[changed.find("words")] = 'W';
  write_file(file_, changed);
  EXPECT_THAT(error(), HasSubstr("b/text: is a damaged member"));
  // The directory claims that "a" has 1 GB more: bytes 24 to 27 of its entry.
  changed = whole;
  const std::size_t entry = changed.rfind("PK\1\2", changed.rfind("PK\1\2") - 1);
  changed[entry + 27] = 0x40;
  write_file(file_, changed);
  EXPECT_THAT(error(), HasSubstr("damaged member"));
}

TEST_F(Zip, IsWrittenWholeOrNotAtAll) {
  EXPECT_THROW(write_zip(folder_.path / "missing/a.usdz", std::vector<ZipMember>{}), IoError);
  EXPECT_THROW(write_zip(file_, std::vector<ZipMember>{{std::string(70'000, 'n'), "x"}}), IoError);
  EXPECT_TRUE(std::filesystem::is_empty(folder_.path));
}

}  // namespace
}  // namespace redrive
