// A thin layer over SQLite: ownership and errors.

#pragma once

#include <memory>
#include <stdexcept>
#include <string>

#include <sqlite3.h>

namespace mfir {

// SQLite's message. Callers turn it into an error of ours.
struct SqliteError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

class SqliteStatement {
 public:
  SqliteStatement(sqlite3* database, const std::string& sql)
      : statement_(nullptr, &sqlite3_finalize) {
    sqlite3_stmt* statement = nullptr;
    if (sqlite3_prepare_v2(database, sql.c_str(), -1, &statement, nullptr) !=
        SQLITE_OK) {
      throw SqliteError(sqlite3_errmsg(database));
    }
    statement_.reset(statement);
  }

  sqlite3_stmt* Get() const { return statement_.get(); }

  // False when there are no more rows.
  bool Step() {
    const int result = sqlite3_step(Get());
    if (result != SQLITE_ROW && result != SQLITE_DONE) {
      throw SqliteError(sqlite3_errmsg(sqlite3_db_handle(Get())));
    }
    return result == SQLITE_ROW;
  }

  // Makes it ready for other values.
  void Reset() {
    sqlite3_reset(Get());
    sqlite3_clear_bindings(Get());
  }

  // As text, whatever its type.
  std::string Text(int column) const {
    const unsigned char* text = sqlite3_column_text(Get(), column);
    return text == nullptr ? "" : reinterpret_cast<const char*>(text);
  }

 private:
  std::unique_ptr<sqlite3_stmt, int (*)(sqlite3_stmt*)> statement_;
};

class SqliteFile {
 public:
  // `flags` of sqlite3_open_v2.
  SqliteFile(const std::string& path, int flags)
      : database_(nullptr, &sqlite3_close_v2) {
    sqlite3* database = nullptr;
    const int result = sqlite3_open_v2(path.c_str(), &database, flags, nullptr);
    database_.reset(database);
    if (result != SQLITE_OK) {
      throw SqliteError(sqlite3_errstr(result));
    }
  }

  sqlite3* Get() const { return database_.get(); }

  void Execute(const std::string& sql) {
    SqliteStatement statement(Get(), sql);
    while (statement.Step()) {
    }
  }

 private:
  std::unique_ptr<sqlite3, int (*)(sqlite3*)> database_;
};

}  // namespace mfir
