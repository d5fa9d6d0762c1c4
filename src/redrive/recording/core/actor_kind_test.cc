// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/core/actor_kind.h"

#include <set>
#include <string>

#include <gtest/gtest.h>

namespace redrive {
namespace {

TEST(ActorKind, EveryWordBelongsToOneKind) {
  std::set<std::string> names;
  std::set<std::string_view> words;
  for (const ActorKind& kind : actor_kinds()) {
    EXPECT_TRUE(names.insert(kind.name).second) << kind.name;
    EXPECT_GE(kind.core, 0) << kind.name;
    EXPECT_LE(kind.core, 1) << kind.name;
    for (const std::string_view word : kind.words) {
      EXPECT_TRUE(words.insert(word).second) << word;
      EXPECT_STREQ(kind_of(word).name, kind.name) << word;
    }
  }
}

TEST(ActorKind, MovesFromBoxToBox) {
  Rigid3d a = Rigid3d::Identity(), b = a;
  a.translation() = Eigen::Vector3d(3, 1, 0.5);
  b.translation() = Eigen::Vector3d(4, 1.3, 0.5);
  b.linear() = Eigen::AngleAxisd(0.2, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  for (const ActorKind& kind : actor_kinds()) {
    EXPECT_TRUE(kind.between(a, b, 0).isApprox(a, 1e-12)) << kind.name;
    EXPECT_TRUE(kind.between(a, b, 1).isApprox(b, 1e-12)) << kind.name;
    const Rigid3d middle = kind.between(a, b, 0.5);
    EXPECT_EQ(rigid_obstacle(middle.matrix()), "") << kind.name;
    EXPECT_LE((middle.translation() - a.translation()).norm(), 1.1) << kind.name;
  }
}

TEST(ActorKind, IsFoundInTheWordsOfEveryDataSet) {
  for (const char* type : {"human.pedestrian.adult", "animal", "Pedestrian", "Person_sitting",
                           "Person (sitting)", "Cyclist", "person", "rider", "PEDESTRIAN"})
    EXPECT_STREQ(kind_of(type).name, "person") << type;
  for (const char* type : {"CAR", "vehicle.bicycle", "Misc", "found", "class 7", "", "personal"})
    EXPECT_STREQ(kind_of(type).name, "vehicle") << type;
}

}  // namespace
}  // namespace redrive
