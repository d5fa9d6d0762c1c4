// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/rosbag/sqlite_file.h"

#include <algorithm>
#include <map>
#include <mutex>

#include <sqlite3.h>

#include "redrive/base/error.h"

namespace redrive::rosbag {
namespace {

namespace fs = std::filesystem;

class SqliteFile : public BagFile {
 public:
  explicit SqliteFile(const fs::path& path) : path_(path) {
    sqlite3* opened = nullptr;
    const int status = sqlite3_open_v2(path.c_str(), &opened, SQLITE_OPEN_READONLY, nullptr);
    database_.reset(opened);
    if (status != SQLITE_OK) fail();
    // A database may come from a stranger.
    sqlite3_db_config(opened, SQLITE_DBCONFIG_DEFENSIVE, 1, nullptr);
    sqlite3_db_config(opened, SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0, nullptr);
    sqlite3_db_config(opened, SQLITE_DBCONFIG_ENABLE_VIEW, 0, nullptr);
    std::map<std::string, std::pair<std::string, std::string>> schemas;
    if (has_table("message_definitions"))
      each_row("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions",
               [&](sqlite3_stmt* row) {
                 schemas[text(row, 0)] = {text(row, 1), text(row, 2)};
               });
    std::map<std::int64_t, Topic> topics;
    each_row("SELECT id, name, type, serialization_format FROM topics", [&](sqlite3_stmt* row) {
      Topic& topic = topics[sqlite3_column_int64(row, 0)];
      topic.name = text(row, 1);
      topic.type = text(row, 2);
      topic.encoding = text(row, 3);
      if (const auto schema = schemas.find(topic.type); schema != schemas.end())
        std::tie(topic.schema_encoding, topic.schema) = schema->second;
    });
    each_row("SELECT id, topic_id, timestamp FROM messages", [&](sqlite3_stmt* row) {
      const auto topic = topics.find(sqlite3_column_int64(row, 1));
      if (topic == topics.end()) return;
      topic->second.messages.push_back({sqlite3_column_int64(row, 2),
                                        static_cast<std::uint64_t>(sqlite3_column_int64(row, 0)), 0,
                                        0});
    });
    for (auto& [id, topic] : topics) topics_.push_back(std::move(topic));
  }

  void read(std::span<const Message> messages, std::size_t most,
            const TakeMessage& take) const override {
    for (std::size_t i = 0; i < messages.size(); ++i) take(i, blob(messages[i], most));
  }

 private:
  struct Close {
    void operator()(sqlite3* database) const { sqlite3_close(database); }
    void operator()(sqlite3_stmt* statement) const { sqlite3_finalize(statement); }
    void operator()(sqlite3_blob* blob) const { sqlite3_blob_close(blob); }
  };

  [[noreturn]] void fail(const std::string& of = "") const {
    throw InputError(path_, of, "",
                     "not usable as SQLite: " + std::string(sqlite3_errmsg(database_.get())));
  }
  static std::string text(sqlite3_stmt* row, int column) {
    const unsigned char* const bytes = sqlite3_column_text(row, column);
    return bytes ? std::string(reinterpret_cast<const char*>(bytes)) : std::string();
  }
  template <class Take>
  void each_row(const char* query, const Take& take) const {
    sqlite3_stmt* made = nullptr;
    if (sqlite3_prepare_v2(database_.get(), query, -1, &made, nullptr) != SQLITE_OK) fail();
    const std::unique_ptr<sqlite3_stmt, Close> statement(made);
    int status;
    while ((status = sqlite3_step(made)) == SQLITE_ROW) take(made);
    if (status != SQLITE_DONE) fail();
  }
  bool has_table(const std::string& name) const {
    bool found = false;
    each_row("SELECT name FROM sqlite_master WHERE type = 'table'",
             [&](sqlite3_stmt* row) { found |= text(row, 0) == name; });
    return found;
  }
  std::string blob(const Message& message, std::size_t most) const {
    const std::lock_guard lock(mutex_);
    const std::string row = "row " + std::to_string(message.offset) + " of messages";
    sqlite3_blob* made = nullptr;
    if (sqlite3_blob_open(database_.get(), "main", "messages", "data",
                          static_cast<sqlite3_int64>(message.offset), 0, &made) != SQLITE_OK)
      fail(row);
    const std::unique_ptr<sqlite3_blob, Close> opened(made);
    const auto size = static_cast<std::size_t>(std::max(0, sqlite3_blob_bytes(made)));
    std::string bytes(std::min(most, size), '\0');
    if (sqlite3_blob_read(made, bytes.data(), static_cast<int>(bytes.size()), 0) != SQLITE_OK)
      fail(row);
    return bytes;
  }

  fs::path path_;
  std::unique_ptr<sqlite3, Close> database_;
  mutable std::mutex mutex_;
};

}  // namespace

std::unique_ptr<BagFile> open_sqlite(const fs::path& path) {
  return std::make_unique<SqliteFile>(path);
}

}  // namespace redrive::rosbag
