// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/parse/data_frame.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>

#include "redrive/base/error.h"
#include "redrive/recording/parse/little_endian.h"
#include "redrive/recording/parse/pickle.h"

namespace redrive {
namespace {

using Kind = PickleValue::Kind;

// numpy 2 and pandas 2 moved some of them.
constexpr std::array<std::string_view, 22> kGlobals = {
    "pandas.core.frame DataFrame",
    "pandas.core.internals BlockManager",
    "pandas.core.internals.managers BlockManager",
    "pandas._libs.internals _unpickle_block",
    "pandas.core.indexes.base Index",
    "pandas.core.indexes.base _new_Index",
    "pandas.core.indexes.range RangeIndex",
    "pandas.core.indexes.numeric Int64Index",
    "pandas.indexes.base Index",
    "pandas.indexes.base _new_Index",
    "pandas.indexes.range RangeIndex",
    "pandas.indexes.numeric Int64Index",
    "numpy ndarray",
    "numpy dtype",
    "numpy.core.multiarray _reconstruct",
    "numpy._core.multiarray _reconstruct",
    "numpy.core.multiarray scalar",
    "numpy._core.multiarray scalar",
    "numpy.core.numeric _frombuffer",
    "numpy._core.numeric _frombuffer",
    "builtins slice",
    "__builtin__ slice",
};

/// Type of numpy's numbers: 'f', 'i', 'u' or 'b' with its bytes, or 'O' for any objects.
struct NumberType {
  char letter = 'O';
  std::size_t bytes = 0;
};

/// An array of numpy: rows x columns of bytes, or a list of objects.
struct Array {
  NumberType type;
  std::vector<std::size_t> shape = {};
  bool by_columns = false;               ///< Fortran's order: the first index runs first
  std::string_view bytes = {};           ///< numbers
  const PickleValue* objects = nullptr;  ///< a list

  std::size_t size() const {
    return shape.empty() ? 0 : shape.size() == 1 ? shape[0] : shape[0] * shape[1];
  }
};

std::int64_t integer_at(const Array& array, std::size_t i) {
  const std::size_t at = i * array.type.bytes;
  const bool is_signed = array.type.letter == 'i';
  switch (array.type.bytes) {
    case 1: {
      const auto byte = little_endian<std::uint8_t>(array.bytes, at);
      return is_signed ? static_cast<std::int8_t>(byte) : std::int64_t{byte};
    }
    case 2: {
      const auto word = little_endian<std::uint16_t>(array.bytes, at);
      return is_signed ? static_cast<std::int16_t>(word) : std::int64_t{word};
    }
    case 4: {
      const auto word = little_endian<std::uint32_t>(array.bytes, at);
      return is_signed ? static_cast<std::int32_t>(word) : std::int64_t{word};
    }
    default: return little_endian<std::int64_t>(array.bytes, at);
  }
}

double number_at(const Array& array, std::size_t i) {
  if (array.type.letter != 'f') return static_cast<double>(integer_at(array, i));
  return array.type.bytes == 4 ? double{little_endian<float>(array.bytes, 4 * i)}
                               : little_endian<double>(array.bytes, 8 * i);
}

}  // namespace

class DataFrameReader {
 public:
  DataFrameReader(std::string_view bytes, const std::filesystem::path& file)
      : pickle_(bytes, file, kGlobals) {}

  void read(DataFrame* table) {
    const PickleValue& frame = pickle_.root();
    if (!pickle_.is_object(frame, "DataFrame")) fail("is no DataFrame of pandas");
    const PickleValue& state = pickle_.item(frame, 2);
    const PickleValue* manager = pickle_.find(state, "_mgr");
    if (!manager) manager = pickle_.find(state, "_data");
    if (!manager || !pickle_.is_object(*manager, "BlockManager"))
      fail("has no BlockManager (_mgr or _data) in its DataFrame");
    if (manager->items.size() > 2)
      read_old_manager(pickle_.item(*manager, 2), table);
    else
      read_new_manager(pickle_.item(*manager, 1), table);
  }

 private:
  [[noreturn]] void fail(const std::string& rule) const { pickle_.fail("pickle", "", rule); }

  /// pandas before 1.3: (axes, values, items, {"0.14.1": {"axes", "blocks"}}).
  void read_old_manager(const PickleValue& state, DataFrame* table) {
    const PickleValue* layout = pickle_.find(pickle_.item(state, 3), "0.14.1");
    const PickleValue* axes = layout ? pickle_.find(*layout, "axes") : nullptr;
    const PickleValue* blocks = layout ? pickle_.find(*layout, "blocks") : nullptr;
    if (!axes || !blocks) fail("has a BlockManager without axes and blocks");
    const std::vector<std::string> names = names_of(pickle_.item(*axes, 0));
    for (std::size_t b = 0; b < blocks->items.size(); ++b) {
      const PickleValue& block = pickle_.item(*blocks, b);
      const PickleValue *values = pickle_.find(block, "values"),
                        *columns = pickle_.find(block, "mgr_locs");
      if (!values || !columns) fail("has a block without values and mgr_locs");
      add_block(array_of(*values), *columns, names, table);
    }
  }

  /// pandas from 1.3 on: a call with (blocks, axes).
  void read_new_manager(const PickleValue& arguments, DataFrame* table) {
    const PickleValue& blocks = pickle_.item(arguments, 0);
    const std::vector<std::string> names = names_of(pickle_.item(pickle_.item(arguments, 1), 0));
    for (std::size_t b = 0; b < blocks.items.size(); ++b) {
      const PickleValue& block = pickle_.item(blocks, b);
      if (!pickle_.is_object(block, "_unpickle_block")) fail("has a block of another kind");
      const PickleValue& parts = pickle_.item(block, 1);
      add_block(array_of(pickle_.item(parts, 0)), pickle_.item(parts, 1), names, table);
    }
  }

  std::int64_t integer_of(const PickleValue& value, const char* what) const {
    if (value.kind == Kind::kInteger || value.kind == Kind::kBool) return value.integer;
    fail(std::string("has no integer as ") + what);
  }

  /// Names of columns: an Index of texts, or numbers from a RangeIndex.
  std::vector<std::string> names_of(const PickleValue& index) {
    if (!pickle_.is_object(index, "_new_Index")) fail("has an index of columns of another kind");
    const PickleValue& fields = pickle_.item(pickle_.item(index, 1), 1);
    const PickleValue* data = pickle_.find(fields, "data");
    if (!data) fail("has an index of columns without names");
    const Array array = array_of(*data);
    if (!array.objects || array.shape.size() != 1) fail("has columns without names");
    std::vector<std::string> names;
    for (std::size_t i = 0; i < array.objects->items.size(); ++i) {
      const PickleValue& name = pickle_.item(*array.objects, i);
      if (name.kind != Kind::kText) fail("has a column whose name is no text");
      names.emplace_back(name.text);
    }
    return names;
  }

  NumberType type_of(const PickleValue& dtype) const {
    if (!pickle_.is_object(dtype, "dtype")) fail("has an array of another type than a dtype");
    const PickleValue& code = pickle_.item(pickle_.item(dtype, 1), 0);
    std::string_view name = code.kind == Kind::kText ? code.text : "";
    if (dtype.items.size() > 2 && pickle_.item(pickle_.item(dtype, 2), 1).text == ">")
      fail("has big-endian numbers");
    if (name.starts_with('<') || name.starts_with('|')) name.remove_prefix(1);
    if (name == "O8" || name == "O") return {};
    if (name == "b1") return {'b', 1};
    constexpr std::array<std::string_view, 10> kKnown = {"f4", "f8", "i1", "i2", "i4",
                                                         "i8", "u1", "u2", "u4", "u8"};
    if (std::ranges::find(kKnown, name) == kKnown.end())
      pickle_.fail("dtype", std::string(name.substr(0, 20)),
                   "f4, f8, integers of 1 to 8 bytes, b1 and O8 are read");
    return {name[0], static_cast<std::size_t>(name[1] - '0')};
  }

  void set_shape(const PickleValue& shape, Array* array) const {
    if (shape.kind != Kind::kTuple || shape.items.empty() || shape.items.size() > 2)
      fail("has an array of other than one or two dimensions");
    for (std::size_t i = 0; i < shape.items.size(); ++i) {
      const std::int64_t size = integer_of(pickle_.item(shape, i), "size of an array");
      if (size < 0 || size > static_cast<std::int64_t>(pickle_.size()))
        pickle_.fail("shape", std::to_string(size), "from 0 to the size of the pickle");
      array->shape.push_back(static_cast<std::size_t>(size));
    }
  }

  /// An ndarray with its state (version, shape, dtype, Fortran's order, data), or one of protocol 5
  /// from a buffer (data, dtype, shape, order).
  Array array_of(const PickleValue& value) {
    Array array;
    const PickleValue* data = nullptr;
    if (pickle_.is_object(value, "_reconstruct")) {
      const PickleValue& state = pickle_.item(value, 2);
      set_shape(pickle_.item(state, 1), &array);
      array.type = type_of(pickle_.item(state, 2));
      array.by_columns = integer_of(pickle_.item(state, 3), "an array's order") != 0;
      data = &pickle_.item(state, 4);
    } else if (pickle_.is_object(value, "_frombuffer")) {
      const PickleValue& arguments = pickle_.item(value, 1);
      data = &pickle_.item(arguments, 0);
      array.type = type_of(pickle_.item(arguments, 1));
      set_shape(pickle_.item(arguments, 2), &array);
      array.by_columns = pickle_.item(arguments, 3).text == "F";
    } else {
      fail("has columns of another kind than arrays of numpy");
    }
    if (array.type.letter == 'O') {
      if (data->kind != Kind::kList || data->items.size() != array.size())
        fail("has an array of objects with another number of them than its shape says");
      array.objects = data;
    } else if (data->kind != Kind::kBytes || data->text.size() != array.size() * array.type.bytes) {
      pickle_.fail("array", std::to_string(data->text.size()) + " bytes",
                   "its shape needs " + std::to_string(array.size() * array.type.bytes));
    } else {
      array.bytes = data->text;
    }
    return array;
  }

  /// Indices of a block's columns: a slice or an array.
  std::vector<std::size_t> columns_of(const PickleValue& where, std::size_t count,
                                      std::size_t names) {
    std::vector<std::size_t> columns;
    const auto add = [&](std::int64_t column) {
      if (column < 0 || column >= static_cast<std::int64_t>(names))
        pickle_.fail("mgr_locs", std::to_string(column), "there is no such column");
      columns.push_back(static_cast<std::size_t>(column));
    };
    if (pickle_.is_object(where, "slice")) {
      const PickleValue& bounds = pickle_.item(where, 1);
      const std::int64_t begin = integer_of(pickle_.item(bounds, 0), "begin of a slice");
      const PickleValue& by = pickle_.item(bounds, 2);
      const std::int64_t step = by.kind == Kind::kNone ? 1 : integer_of(by, "step of a slice");
      if (begin < 0 || begin > std::int64_t(names) || step < 1 || step > std::int64_t(names))
        fail("has a slice that does not run upwards through the columns");
      for (std::size_t i = 0; i < count; ++i) add(begin + std::int64_t(i) * step);
    } else {
      const Array array = array_of(where);
      if (array.objects || array.shape.size() != 1 || array.size() != count)
        fail("has a block with other numbers of columns and of their places");
      for (std::size_t i = 0; i < count; ++i) add(integer_at(array, i));
    }
    return columns;
  }

  void add_block(const Array& values, const PickleValue& where,
                 const std::vector<std::string>& names, DataFrame* table) {
    if (values.shape.size() != 2) fail("has a block that is no matrix");
    const std::size_t count = values.shape[0], rows = values.shape[1];
    if (count == 0) return;
    if (!table->columns_.empty() && rows != table->rows_)
      pickle_.fail("rows", std::to_string(rows),
                   "other columns have " + std::to_string(table->rows_));
    table->rows_ = rows;
    const std::vector<std::size_t> columns = columns_of(where, count, names.size());
    for (std::size_t c = 0; c < count; ++c) {
      // Blocks that share their bytes would fill the memory.
      if ((values_ += rows) > pickle_.size()) fail("has more values than bytes");
      const auto index = [&](std::size_t r) {
        return values.by_columns ? c + r * count : c * rows + r;
      };
      DataFrame::Column column;
      if (values.objects) {
        column = objects_column(values, index, rows);
      } else {
        std::vector<double> numbers(rows);
        for (std::size_t r = 0; r < rows; ++r) numbers[r] = number_at(values, index(r));
        column = std::move(numbers);
      }
      table->columns_[names[columns[c]]] = std::move(column);
    }
  }

  /// The number that a value is, also one of numpy's; nothing for texts and others.
  std::optional<double> number_of(const PickleValue& value) {
    switch (value.kind) {
      case Kind::kNumber: return value.number;
      case Kind::kInteger:
      case Kind::kBool: return static_cast<double>(value.integer);
      default: break;
    }
    if (!pickle_.is_object(value, "scalar")) return std::nullopt;
    const PickleValue& arguments = pickle_.item(value, 1);
    Array array{.type = type_of(pickle_.item(arguments, 0)), .shape = {1}};
    array.bytes = pickle_.item(arguments, 1).text;
    if (array.type.letter == 'O' || array.bytes.size() != array.type.bytes)
      fail("has a scalar of another size than its dtype says");
    return number_at(array, 0);
  }

  /// Numbers where all objects are, else texts, empty for None and NaN.
  template <class Index>
  DataFrame::Column objects_column(const Array& values, const Index& index, std::size_t rows) {
    std::vector<double> numbers;
    std::vector<std::string_view> texts;
    bool has_text = false, has_number = false;
    for (std::size_t r = 0; r < rows; ++r) {
      const PickleValue& value = pickle_.item(*values.objects, index(r));
      const std::optional<double> number = number_of(value);
      has_text = has_text || value.kind == Kind::kText;
      has_number = has_number || (number && std::isfinite(*number));
      if (value.kind != Kind::kText && value.kind != Kind::kNone && !number)
        fail("has a column of objects that are neither texts nor numbers");
      numbers.push_back(number.value_or(std::numeric_limits<double>::quiet_NaN()));
      texts.push_back(value.text);
    }
    if (has_number && !has_text) return numbers;
    return texts;
  }

  Pickle pickle_;
  std::size_t values_ = 0;
};

DataFrame::DataFrame(std::string_view pickle, const std::filesystem::path& file) : file_(file) {
  DataFrameReader(pickle, file).read(this);
}

template <class T>
const std::vector<T>& DataFrame::column(const std::string& name, const char* what) const {
  const auto found = columns_.find(name);
  if (found == columns_.end()) throw InputError(file_, name, "", "there is no such column");
  const auto* values = std::get_if<std::vector<T>>(&found->second);
  if (!values) throw InputError(file_, name, "", std::string("the column must hold ") + what);
  return *values;
}

const std::vector<double>& DataFrame::numbers(const std::string& name) const {
  return column<double>(name, "numbers");
}

const std::vector<std::string_view>& DataFrame::texts(const std::string& name) const {
  return column<std::string_view>(name, "texts");
}

}  // namespace redrive
