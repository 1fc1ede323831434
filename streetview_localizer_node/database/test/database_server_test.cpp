// The same database on a PostGIS server, one of the test's own on a Unix socket. Skipped where no server is installed.
#include <gtest/gtest.h>
#include <pwd.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <set>

#include "stored_scene.h"
#include "test_files.h"

namespace streetview_localizer {
namespace {

namespace fs = std::filesystem;

// Folder of the newest installed server's programs; empty if there is none.
std::string serverPrograms() {
  std::set<std::pair<int, std::string>> found;
  std::error_code none;
  for (const auto& version : fs::directory_iterator("/usr/lib/postgresql", none))
    if (fs::exists(version.path() / "bin/initdb"))
      found.emplace(std::atoi(version.path().filename().c_str()), (version.path() / "bin").string());
  return found.empty() ? "" : found.rbegin()->second;
}

class DatabaseServer : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    const std::string programs = serverPrograms();
    if (programs.empty()) {
      reason_ = "no PostgreSQL server is installed (postgresql-15-postgis-3)";
      return;
    }
    folder_ = new TemporaryFolder();
    const std::string socket = *folder_ / "";
    // The server refuses to run as root.
    const passwd* user = geteuid() == 0 ? getpwnam("postgres") : nullptr;
    if (user && chown(socket.c_str(), user->pw_uid, user->pw_gid) != 0) reason_ = "cannot give the folder to postgres";
    as_ = user ? "runuser -u postgres -- " : "";
    stop_ = programs + "/pg_ctl -D " + socket + "data -m immediate stop";
    const std::string name = "host=" + socket + " user=postgres";
    if (run(programs + "/initdb -U postgres -A trust -N -D " + socket + "data") &&
        run(programs + "/pg_ctl -D " + socket + "data -l " + socket +
            "log -w -o '-c listen_addresses= -c fsync=off -k " + socket + "' start"))
      run(programs + "/psql '" + name + "' -c 'CREATE EXTENSION postgis'");
    path_ = "PG:" + name + " dbname=postgres";
  }

  static void TearDownTestSuite() {
    if (!stop_.empty()) run(stop_);
    delete folder_;
  }

  void SetUp() override {
    if (!reason_.empty()) GTEST_SKIP() << reason_;
    run(serverPrograms() + "/psql '" + path_.substr(3) +
        "' -c 'DROP TABLE IF EXISTS panoramas, views, buildings, street_view_database'");
  }

  static bool run(const std::string& command) {
    if (!reason_.empty()) return false;
    const std::string log = *folder_ / "output";
    if (std::system(("cd / && " + as_ + command + " > " + log + " 2>&1").c_str()) == 0) return true;
    std::ifstream file(log);
    reason_ = "`" + command + "` fails: " + std::string(std::istreambuf_iterator<char>(file), {});
    return false;
  }

  static TemporaryFolder* folder_;
  static std::string as_, path_, reason_, stop_;
};

TemporaryFolder* DatabaseServer::folder_ = nullptr;
std::string DatabaseServer::as_, DatabaseServer::path_, DatabaseServer::reason_, DatabaseServer::stop_;

TEST_F(DatabaseServer, ComesBackAsItWentIn) {
  writeDatabase(path_, 5);
  const StreetviewDatabase d = loadDatabase(path_);
  EXPECT_EQ(d.crs, "EPSG:2056");
  EXPECT_LT((d.origin - Eigen::Vector3d(2683500, 1247800, 410)).norm(), 1e-9);
  ASSERT_EQ(d.panoramas.size(), 5u);
  for (int i = 0; i < 5; ++i) expectPanorama(d, i, i);
  EXPECT_EQ(d.model.building_ids, swissModel().building_ids);
  EXPECT_NEAR(d.model.mesh.area(), swissModel().mesh.area(), 1e-3);
}

TEST_F(DatabaseServer, PartByTheSpatialIndex) {
  writeDatabase(path_, 20);  // 12 m apart, along the east
  DatabaseLoadOptions options;
  options.centre = Eigen::Vector2d(2683500 + 60, 1247800);
  options.radius = 30;
  const StreetviewDatabase d = loadDatabase(path_, options);
  ASSERT_EQ(d.panoramas.size(), 5u);
  for (int i = 0; i < 5; ++i) expectPanorama(d, i, i + 3);
}

TEST_F(DatabaseServer, KilledBuildGoesOnAndAFinishedOneIsAddedTo) {
  const pid_t child = fork();
  if (child == 0) {
    DatabaseWriter writer(path_, swissModel(), "settings");
    writer.plan({panoramaAt(0), panoramaAt(1), panoramaAt(2)});
    for (int i = 0; i < 2; ++i) writer.add(panoramaAt(i), viewsAt(i));
    kill(getpid(), SIGKILL);
  }
  int status = 0;
  waitpid(child, &status, 0);
  ASSERT_TRUE(WIFSIGNALED(status));
  const std::string m = messageOf([&] { loadDatabase(path_); });
  EXPECT_NE(m.find("not finished"), std::string::npos) << m;
  for (int i = 2; i < 4; ++i) {
    DatabaseWriter writer(path_, swissModel(), "settings");
    EXPECT_TRUE(writer.has(panoramaAt(i - 1).id));
    EXPECT_FALSE(writer.has(panoramaAt(i).id));
    writer.add(panoramaAt(i), viewsAt(i));
    writer.finish();
  }
  const StreetviewDatabase d = loadDatabase(path_);
  ASSERT_EQ(d.panoramas.size(), 4u);
  for (int i = 0; i < 4; ++i) expectPanorama(d, i, i);
}

TEST_F(DatabaseServer, WhileABuildWritesASecondIsRefused) {
  DatabaseWriter first(path_, swissModel(), "settings");
  const std::string m = messageOf([&] { DatabaseWriter(path_, swissModel(), "settings"); });
  EXPECT_NE(m.find("another program is writing it"), std::string::npos) << m;
}

TEST_F(DatabaseServer, BrokenOnesGiveOneClearLine) {
  for (const std::string& path : {path_, path_ + "x", std::string("PG:host=/nowhere dbname=city")}) {
    const std::string m = messageOf([&] { loadDatabase(path); });
    EXPECT_NE(m.find(path), std::string::npos) << m;
    EXPECT_EQ(m.find('\n'), std::string::npos) << m;
  }
}

}  // namespace
}  // namespace streetview_localizer
