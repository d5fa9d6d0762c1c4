// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/processes/process_group.h"

#include <dlfcn.h>

#include <cstdlib>

#include "redrive/base/error.h"
#include "redrive/base/processes/own_library.h"

namespace redrive {
namespace {

constexpr const char* kLibrary = "libredrive_mpi.so";

/// Returns the launcher's environment variable; null where none started this process.
const char* launcher_variable() {
  // Open MPI's mpirun, MPICH's and srun --mpi=pmi2, srun --mpi=pmix.
  for (const char* name : {"OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMIX_RANK"})
    if (std::getenv(name)) return name;
  return nullptr;
}

/// Number of tasks that srun started this process with; 1 outside of srun.
int srun_tasks() {
  const char* const tasks = std::getenv("SLURM_STEP_NUM_TASKS");
  const bool in_step = std::getenv("SLURM_STEP_ID") && std::getenv("SLURM_PROCID");
  return tasks && in_step ? std::atoi(tasks) : 1;
}

void* load_library(const char* launcher) {
  std::string why;
  // Open MPI's components look its symbols up globally.
  if (void* const library = load_own_library(kLibrary, RTLD_NOW | RTLD_GLOBAL, &why))
    return library;
  if (!why.empty()) throw UsageError(launcher, "", "MPI cannot be used: " + why);
  throw UsageError(launcher, "",
                   std::string("a launcher started several processes, and this build has no ") +
                       kLibrary + ", which needs MPI (Debian: libopenmpi-dev) when it is built");
}

}  // namespace

int launched_rank() {
  for (const char* name : {"OMPI_COMM_WORLD_RANK", "PMI_RANK", "PMIX_RANK", "SLURM_PROCID"})
    if (const char* const rank = std::getenv(name)) return std::atoi(rank);
  return 0;
}

std::unique_ptr<ProcessGroup> join_process_group() {
  const char* launcher = launcher_variable();
  const int tasks = srun_tasks();
  if (!launcher && tasks > 1) launcher = "SLURM_STEP_NUM_TASKS";
  if (!launcher) return std::make_unique<ProcessGroup>();
  void* const library = load_library(launcher);
  const auto join = reinterpret_cast<ProcessGroup* (*)()>(dlsym(library, "redrive_join_mpi"));
  if (!join) throw UsageError(launcher, "", std::string("MPI cannot be used: ") + dlerror());
  std::unique_ptr<ProcessGroup> group(join());
  if (group->size() < tasks)
    throw UsageError("srun", std::to_string(tasks) + " tasks",
                     "do not find each other: start them with mpirun, or with an --mpi of srun "
                     "that this MPI knows");
  return group;
}

}  // namespace redrive
