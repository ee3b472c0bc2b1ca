// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later

// Counts what a process sends, through MPI's profiling interface: functions take the place of those
// of MPI for all of the program (LD_PRELOAD), call the true ones, PMPI_…, and count. Those with
// counts and types are written by traffic.py into functions.h. Communicators of one process do not
// count.
//
//   messages      point-to-point messages sent, those of persistent requests at each start
//   bytes         their bytes
//   neighbours    processes, by their rank in MPI_COMM_WORLD, that messages were sent to
//   reductions    collective calls on communicators of all processes
//   contributed   bytes that the process puts into them
//   others        collective calls on smaller communicators

#include <mpi.h>
#include <stdlib.h>
#include <string.h>

enum { MESSAGES, BYTES, NEIGHBOURS, REDUCTIONS, CONTRIBUTED, OTHERS, COUNTERS };

static double counters[COUNTERS];
static char *met;  // whether a message went to each process of MPI_COMM_WORLD
static int world = 0;

static struct Persistent {
  MPI_Request request;
  double bytes;
  int to;
} *kept;
static int n_kept = 0, room = 0;

static int ranks(MPI_Comm comm) {
  int size = 1;
  if (!world) {
    PMPI_Comm_size(MPI_COMM_WORLD, &world);
    met = calloc((size_t)world, 1);
  }
  PMPI_Comm_size(comm, &size);
  return size;
}

static int rank(MPI_Comm comm) {
  int own = 0;
  PMPI_Comm_rank(comm, &own);
  return own;
}

static double size_of(MPI_Count count, MPI_Datatype type) {
  int bytes = 0;
  if (type != MPI_DATATYPE_NULL) PMPI_Type_size(type, &bytes);
  return (double)count * bytes;
}

static int world_rank(int number, MPI_Comm comm) {
  MPI_Group group, all;
  int found = MPI_UNDEFINED, inter = 0;
  PMPI_Comm_test_inter(comm, &inter);
  if (inter) return MPI_UNDEFINED;
  PMPI_Comm_group(comm, &group);
  PMPI_Comm_group(MPI_COMM_WORLD, &all);
  PMPI_Group_translate_ranks(group, 1, &number, all, &found);
  PMPI_Group_free(&group);
  PMPI_Group_free(&all);
  return found;
}

static void sent(double bytes, int to) {
  counters[MESSAGES] += 1;
  counters[BYTES] += bytes;
  if (to >= 0 && to < world) met[to] = 1;
}

static void message(double bytes, int to, MPI_Comm comm) {
  if (to != MPI_PROC_NULL && ranks(comm) > 1) sent(bytes, world_rank(to, comm));
}

static void persistent(MPI_Request request, double bytes, int to, MPI_Comm comm) {
  if (to == MPI_PROC_NULL || ranks(comm) == 1) return;
  if (n_kept == room) {
    room = 2 * room + 64;
    kept = realloc(kept, (size_t)room * sizeof *kept);
  }
  kept[n_kept++] = (struct Persistent){request, bytes, world_rank(to, comm)};
}

static void collective(double bytes, MPI_Comm comm) {
  int size = ranks(comm);
  if (size == 1) return;
  counters[size == world ? REDUCTIONS : OTHERS] += 1;
  if (size == world) counters[CONTRIBUTED] += bytes;
}

// Set *to to the ranks that this process sends to in a graph, and return their number. The caller
// frees *to.
static int neighbours(MPI_Comm comm, int **to) {
  int in = 0, out = 0, weighted = 0;
  PMPI_Dist_graph_neighbors_count(comm, &in, &out, &weighted);
  // Destinations first, then their weights, sources and the weights of these, which are not used.
  int *all = malloc((size_t)(2 * (in + out) + 1) * sizeof(int));
  PMPI_Dist_graph_neighbors(comm, in, all + 2 * out, all + 2 * out + in, out, all, all + out);
  *to = all;
  return ranks(comm) > 1 ? out : 0;
}

// What the benchmark calls.

void traffic_reset(void) {
  ranks(MPI_COMM_WORLD);
  memset(counters, 0, sizeof counters);
  memset(met, 0, (size_t)world);
}

void traffic_read(double *values) {
  counters[NEIGHBOURS] = 0;
  for (int i = 0; i < ranks(MPI_COMM_WORLD); i++) counters[NEIGHBOURS] += met[i];
  memcpy(values, counters, sizeof counters);
}

// Persistent requests.

static struct Persistent *find(MPI_Request request) {
  for (int i = n_kept - 1; i >= 0; i--)
    if (kept[i].request == request) return kept + i;
  return NULL;
}

int MPI_Startall(int n, MPI_Request r[]) {
  for (int i = 0; i < n; i++) {
    struct Persistent *found = find(r[i]);
    if (found) sent(found->bytes, found->to);
  }
  return PMPI_Startall(n, r);
}

int MPI_Start(MPI_Request *r) { return MPI_Startall(1, r); }

int MPI_Request_free(MPI_Request *r) {
  struct Persistent *found = find(*r);
  if (found) *found = kept[--n_kept];
  return PMPI_Request_free(r);
}

#include "functions.h"
