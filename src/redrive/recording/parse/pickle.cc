// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/parse/pickle.h"

#include <algorithm>
#include <bit>
#include <optional>
#include <unordered_map>

#include "redrive/base/error.h"
#include "redrive/recording/parse/little_endian.h"

namespace redrive {

namespace {

using Kind = PickleValue::Kind;

constexpr std::size_t kMaxValues = 4'000'000;  // 70 bytes each
constexpr std::string_view kEncode = "_codecs encode";

/// Opcodes as pickletools.py names them.
enum Opcode : std::uint8_t {
  kMark = '(',
  kStop = '.',
  kPop = '0',
  kNone = 'N',
  kBinInt = 'J',
  kBinInt1 = 'K',
  kBinInt2 = 'M',
  kBinFloat = 'G',
  kBinUnicode = 'X',
  kBinBytes = 'B',
  kShortBinBytes = 'C',
  kEmptyTuple = ')',
  kTuple = 't',
  kEmptyList = ']',
  kAppend = 'a',
  kAppends = 'e',
  kEmptyDict = '}',
  kSetItem = 's',
  kSetItems = 'u',
  kBinPut = 'q',
  kLongBinPut = 'r',
  kBinGet = 'h',
  kLongBinGet = 'j',
  kGlobal = 'c',
  kReduce = 'R',
  kBuild = 'b',
  kProto = 0x80,
  kNewObj = 0x81,
  kTuple1 = 0x85,
  kTuple2 = 0x86,
  kTuple3 = 0x87,
  kNewTrue = 0x88,
  kNewFalse = 0x89,
  kLong1 = 0x8a,
  kShortBinUnicode = 0x8c,
  kBinUnicode8 = 0x8d,
  kBinBytes8 = 0x8e,
  kStackGlobal = 0x93,
  kMemoize = 0x94,
  kFrame = 0x95,
  kByteArray8 = 0x96
};

std::string in_hex(std::uint8_t byte) {
  constexpr const char* kDigits = "0123456789abcdef";
  return std::string("0x") + kDigits[byte >> 4] + kDigits[byte & 15];
}

/// Returns the bytes of which a text has one code point each, up to U+00FF; nothing for others.
std::optional<std::string> latin_bytes(std::string_view text) {
  std::string bytes;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const auto byte = static_cast<unsigned char>(text[i]);
    if (byte < 0x80) {
      bytes.push_back(text[i]);
    } else if ((byte == 0xc2 || byte == 0xc3) && i + 1 < text.size()) {
      ++i;
      bytes.push_back(static_cast<char>((byte & 3) << 6 | (text[i] & 0x3f)));
    } else {
      return std::nullopt;
    }
  }
  return bytes;
}

}  // namespace

/// Runs the opcodes, which push values on a stack and take them from it.
class PickleMachine {
 public:
  PickleMachine(Pickle* pickle, std::span<const std::string_view> globals)
      : pickle_(*pickle), bytes_(pickle->bytes_), globals_(globals) {}

  void run() {
    for (;;) {
      begin_ = at_;
      opcode_ = take<std::uint8_t>();
      if (opcode_ == kStop) break;
      if (!push_atom() && !push_text() && !change_container() && !use_memo() && !make_object())
        fail("", "is no opcode that tables of pandas and numpy need");
    }
    pickle_.root_ = pop();
  }

 private:
  [[noreturn]] void fail(const std::string& value, const std::string& rule) const {
    pickle_.fail("opcode " + in_hex(opcode_) + " at byte " + std::to_string(begin_), value, rule);
  }

  std::string_view take_bytes(std::uint64_t count) {
    if (count > bytes_.size() - at_) fail("", "goes on behind the end of the pickle (truncated?)");
    at_ += count;
    return bytes_.substr(at_ - count, count);
  }
  template <class T>
  T take() {
    return little_endian<T>(take_bytes(sizeof(T)), 0);
  }

  std::uint32_t add(PickleValue value) {
    if (pickle_.values_.size() >= kMaxValues)
      fail("", "more than " + std::to_string(kMaxValues) + " values");
    pickle_.values_.push_back(std::move(value));
    return static_cast<std::uint32_t>(pickle_.values_.size() - 1);
  }
  void push(PickleValue value) { stack_.push_back(add(std::move(value))); }
  std::size_t floor() const { return marks_.empty() ? 0 : marks_.back(); }
  std::uint32_t pop() {
    if (stack_.size() <= floor()) fail("", "takes a value from an empty stack");
    const std::uint32_t value = stack_.back();
    stack_.pop_back();
    return value;
  }
  /// Takes the values above the last mark.
  std::vector<std::uint32_t> pop_to_mark() {
    if (marks_.empty()) fail("", "has no mark before it");
    const auto begin = stack_.begin() + static_cast<std::ptrdiff_t>(marks_.back());
    std::vector<std::uint32_t> values(begin, stack_.end());
    stack_.erase(begin, stack_.end());
    marks_.pop_back();
    return values;
  }
  /// Value on top of the stack, which must be of the kind.
  PickleValue& top(Kind kind, const char* what) {
    if (stack_.size() <= floor() || pickle_.at(stack_.back()).kind != kind)
      fail("", std::string("needs ") + what + " on the stack");
    return pickle_.values_[stack_.back()];
  }

  void push_integer(std::int64_t value) { push({.kind = Kind::kInteger, .integer = value}); }

  bool push_atom() {
    switch (opcode_) {
      case kProto:
        if (const int protocol = take<std::uint8_t>(); protocol < 2 || protocol > 5)
          fail(std::to_string(protocol), "protocols 2 to 5 are read");
        return true;
      case kFrame: take<std::uint64_t>(); return true;
      case kMark: marks_.push_back(stack_.size()); return true;
      case kPop: pop(); return true;
      case kNone: push({}); return true;
      case kNewTrue:
      case kNewFalse: push({.kind = Kind::kBool, .integer = opcode_ == kNewTrue}); return true;
      case kBinInt: push_integer(take<std::int32_t>()); return true;
      case kBinInt1: push_integer(take<std::uint8_t>()); return true;
      case kBinInt2: push_integer(take<std::uint16_t>()); return true;
      case kLong1: push_integer(take_long()); return true;
      case kBinFloat: {
        std::uint64_t bits = 0;  // big-endian, alone of all numbers
        for (const char byte : take_bytes(8)) bits = bits << 8 | static_cast<unsigned char>(byte);
        push({.kind = Kind::kNumber, .number = std::bit_cast<double>(bits)});
        return true;
      }
      default: return false;
    }
  }

  /// Two's complement in up to 8 bytes.
  std::int64_t take_long() {
    const std::size_t size = take<std::uint8_t>();
    if (size > 8) fail(std::to_string(size) + " bytes", "integers of at most 8 bytes are read");
    const std::string_view digits = take_bytes(size);
    std::uint64_t value = size > 0 && (digits.back() & 0x80) ? ~std::uint64_t{0} : 0;
    for (std::size_t i = size; i-- > 0;) value = value << 8 | static_cast<unsigned char>(digits[i]);
    return static_cast<std::int64_t>(value);
  }

  bool push_text() {
    const auto text = [&](Kind kind, std::uint64_t size) {
      push({.kind = kind, .text = take_bytes(size)});
      return true;
    };
    switch (opcode_) {
      case kShortBinUnicode: return text(Kind::kText, take<std::uint8_t>());
      case kBinUnicode: return text(Kind::kText, take<std::uint32_t>());
      case kBinUnicode8: return text(Kind::kText, take<std::uint64_t>());
      case kShortBinBytes: return text(Kind::kBytes, take<std::uint8_t>());
      case kBinBytes: return text(Kind::kBytes, take<std::uint32_t>());
      case kBinBytes8:
      case kByteArray8: return text(Kind::kBytes, take<std::uint64_t>());
      default: return false;
    }
  }

  void push_tuple(std::vector<std::uint32_t> items) {
    push({.kind = Kind::kTuple, .items = std::move(items)});
  }
  void push_last(std::size_t count) {
    std::vector<std::uint32_t> items(count);
    for (std::size_t i = count; i-- > 0;) items[i] = pop();
    push_tuple(std::move(items));
  }
  void extend(Kind kind, const char* what, const std::vector<std::uint32_t>& items) {
    if (kind == Kind::kDict && items.size() % 2 != 0) fail("", "has a key without a value");
    PickleValue& container = top(kind, what);
    container.items.insert(container.items.end(), items.begin(), items.end());
  }

  bool change_container() {
    switch (opcode_) {
      case kEmptyTuple: push_tuple({}); return true;
      case kTuple: push_tuple(pop_to_mark()); return true;
      case kTuple1: push_last(1); return true;
      case kTuple2: push_last(2); return true;
      case kTuple3: push_last(3); return true;
      case kEmptyList: push({.kind = Kind::kList}); return true;
      case kEmptyDict: push({.kind = Kind::kDict}); return true;
      case kAppend: extend(Kind::kList, "a list", {pop()}); return true;
      case kAppends: extend(Kind::kList, "a list", pop_to_mark()); return true;
      case kSetItem: {
        const std::uint32_t value = pop(), key = pop();
        extend(Kind::kDict, "a dict", {key, value});
        return true;
      }
      case kSetItems: extend(Kind::kDict, "a dict", pop_to_mark()); return true;
      default: return false;
    }
  }

  void put(std::uint64_t slot) {
    if (stack_.size() <= floor()) fail("", "takes a value from an empty stack");
    memo_[slot] = stack_.back();
  }
  void get(std::uint64_t slot) {
    const auto found = memo_.find(slot);
    if (found == memo_.end()) fail(std::to_string(slot), "no value was kept under this number");
    stack_.push_back(found->second);
  }

  bool use_memo() {
    switch (opcode_) {
      case kBinPut: put(take<std::uint8_t>()); return true;
      case kLongBinPut: put(take<std::uint32_t>()); return true;
      case kMemoize: put(memo_.size()); return true;
      case kBinGet: get(take<std::uint8_t>()); return true;
      case kLongBinGet: get(take<std::uint32_t>()); return true;
      default: return false;
    }
  }

  std::string_view take_line() {
    const std::size_t end = bytes_.find('\n', at_);
    if (end == std::string_view::npos) fail("", "has no end of its line");
    const std::string_view line = take_bytes(end - at_);
    ++at_;
    return line;
  }

  void push_global(std::string_view module, std::string_view name) {
    const std::string both = std::string(module) + " " + std::string(name);
    const auto known = std::ranges::find(globals_, both);
    if (known == globals_.end() && both != kEncode)
      fail(
          both.substr(0, 100),
          "a pickle is read as data: objects of pandas and numpy tables are all that may be in it");
    push({.kind = Kind::kGlobal, .text = known == globals_.end() ? kEncode : *known});
  }

  /// Protocol 2 has no bytes: they are a call that encodes a text in Latin-1.
  bool decode(const PickleValue& global, const PickleValue& arguments) {
    if (global.text != kEncode) return false;
    const PickleValue& text = pickle_.item(arguments, 0);
    std::optional<std::string> bytes;
    if (text.kind == Kind::kText) bytes = latin_bytes(text.text);
    if (!bytes) fail("", "encodes no Latin-1 text");
    // A text that is encoded again and again would fill the memory.
    if ((decoded_bytes_ += text.text.size()) > bytes_.size()) fail("", "repeats a text");
    pickle_.decoded_.push_back(*std::move(bytes));
    push({.kind = Kind::kBytes, .text = pickle_.decoded_.back()});
    return true;
  }

  bool make_object() {
    switch (opcode_) {
      case kGlobal: {
        const std::string_view module = take_line();
        push_global(module, take_line());
        return true;
      }
      case kStackGlobal: {
        const PickleValue name = pickle_.at(pop()), module = pickle_.at(pop());
        if (name.kind != Kind::kText || module.kind != Kind::kText)
          fail("", "needs two texts on the stack");
        push_global(module.text, name.text);
        return true;
      }
      case kReduce:
      case kNewObj: {
        const std::uint32_t arguments = pop(), global = pop();
        if (pickle_.at(global).kind != Kind::kGlobal || pickle_.at(arguments).kind != Kind::kTuple)
          fail("", "needs a global and a tuple on the stack");
        if (!decode(pickle_.at(global), pickle_.at(arguments)))
          push({.kind = Kind::kObject, .items = {global, arguments}});
        return true;
      }
      case kBuild: {
        const std::uint32_t state = pop();
        PickleValue& object = top(Kind::kObject, "an object");
        object.items.resize(2);
        object.items.push_back(state);
        return true;
      }
      default: return false;
    }
  }

  Pickle& pickle_;
  std::string_view bytes_;
  std::span<const std::string_view> globals_;
  std::size_t at_ = 0, begin_ = 0, decoded_bytes_ = 0;
  std::uint8_t opcode_ = 0;
  std::vector<std::uint32_t> stack_;
  std::vector<std::size_t> marks_;  ///< sizes of the stack
  std::unordered_map<std::uint64_t, std::uint32_t> memo_;
};

Pickle::Pickle(std::string_view bytes, std::filesystem::path file,
               std::span<const std::string_view> globals)
    : bytes_(bytes), file_(std::move(file)) {
  PickleMachine(this, globals).run();
}

void Pickle::fail(const std::string& field, const std::string& value,
                  const std::string& rule) const {
  throw InputError(file_, field, value, rule);
}

const PickleValue& Pickle::item(const PickleValue& of, std::size_t i) const {
  const bool has_items =
      of.kind == Kind::kTuple || of.kind == Kind::kList || of.kind == Kind::kObject;
  if (!has_items || i >= of.items.size())
    fail("pickle", "", "part " + std::to_string(i) + " of a tuple, list or object is missing");
  return at(of.items[i]);
}

const PickleValue* Pickle::find(const PickleValue& dict, std::string_view key) const {
  if (dict.kind != Kind::kDict) return nullptr;
  for (std::size_t i = 0; i + 1 < dict.items.size(); i += 2) {
    const PickleValue& candidate = at(dict.items[i]);
    if (candidate.kind == Kind::kText && candidate.text == key) return &at(dict.items[i + 1]);
  }
  return nullptr;
}

bool Pickle::is_object(const PickleValue& value, std::string_view name) const {
  if (value.kind != Kind::kObject) return false;
  const std::string_view global = at(value.items[0]).text;
  return global.substr(global.rfind(' ') + 1) == name;
}

}  // namespace redrive
