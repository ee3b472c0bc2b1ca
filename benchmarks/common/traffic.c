// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later

// Counts what a process sends, through MPI's profiling interface: each function here takes the place
// of the one of its name for all of the program (LD_PRELOAD), counts, and calls the true one, PMPI_….
// It sees the calls of C and C++, that is of PETSc, DOLFINx and mpi4py; those of Fortran (MUMPS on
// several processes) go past it. Communicators of one process do not count.
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

typedef struct {
  MPI_Request request;
  double bytes;
  int to;
} Persistent;
static Persistent *kept;
static int n_kept = 0, room = 0;

static void prepare(void) {
  if (!world) {
    PMPI_Comm_size(MPI_COMM_WORLD, &world);
    met = calloc((size_t)world, 1);
  }
}

static double size_of(MPI_Count count, MPI_Datatype type) {
  int bytes = 0;
  if (type != MPI_DATATYPE_NULL) PMPI_Type_size(type, &bytes);
  return (double)count * bytes;
}

static int world_rank(int rank, MPI_Comm comm) {
  MPI_Group group, all;
  int found = MPI_UNDEFINED, inter = 0;
  PMPI_Comm_test_inter(comm, &inter);
  if (inter) return MPI_UNDEFINED;
  PMPI_Comm_group(comm, &group);
  PMPI_Comm_group(MPI_COMM_WORLD, &all);
  PMPI_Group_translate_ranks(group, 1, &rank, all, &found);
  PMPI_Group_free(&group);
  PMPI_Group_free(&all);
  return found;
}

static void sent(double bytes, int to) {
  prepare();
  counters[MESSAGES] += 1;
  counters[BYTES] += bytes;
  if (to >= 0 && to < world) met[to] = 1;
}

static void send_counted(MPI_Count count, MPI_Datatype type, int to, MPI_Comm comm) {
  int size = 1;
  PMPI_Comm_size(comm, &size);
  if (to != MPI_PROC_NULL && size > 1) sent(size_of(count, type), world_rank(to, comm));
}

static void collective(double bytes, MPI_Comm comm) {
  int size = 1;
  prepare();
  PMPI_Comm_size(comm, &size);
  if (size <= 1) return;
  if (size == world) {
    counters[REDUCTIONS] += 1;
    counters[CONTRIBUTED] += bytes;
  } else {
    counters[OTHERS] += 1;
  }
}

// What the benchmark calls.

void traffic_reset(void) {
  prepare();
  memset(counters, 0, sizeof counters);
  memset(met, 0, (size_t)world);
}

void traffic_read(double *values) {
  prepare();
  counters[NEIGHBOURS] = 0;
  for (int i = 0; i < world; i++) counters[NEIGHBOURS] += met[i];
  memcpy(values, counters, sizeof counters);
}

// Point to point.

static void keep(MPI_Request request, double bytes, int to) {
  if (n_kept == room) {
    room = room ? 2 * room : 64;
    kept = realloc(kept, (size_t)room * sizeof *kept);
  }
  kept[n_kept++] = (Persistent){request, bytes, to};
}

static void started(MPI_Request request) {
  for (int i = n_kept - 1; i >= 0; i--) {
    if (kept[i].request == request) {
      sent(kept[i].bytes, kept[i].to);
      return;
    }
  }
}

int MPI_Start(MPI_Request *r) {
  started(*r);
  return PMPI_Start(r);
}

int MPI_Startall(int n, MPI_Request r[]) {
  for (int i = 0; i < n; i++) started(r[i]);
  return PMPI_Startall(n, r);
}

int MPI_Request_free(MPI_Request *r) {
  for (int i = n_kept - 1; i >= 0; i--) {
    if (kept[i].request == *r) {
      kept[i] = kept[--n_kept];
      break;
    }
  }
  return PMPI_Request_free(r);
}

// Collective.

int MPI_Barrier(MPI_Comm c) {
  collective(0, c);
  return PMPI_Barrier(c);
}

int MPI_Ibarrier(MPI_Comm c, MPI_Request *r) {
  collective(0, c);
  return PMPI_Ibarrier(c, r);
}

// Between neighbours: a message to each of them, all of one size or of sizes of their own.

static void to_neighbours(double bytes, const double *each, MPI_Comm c) {
  int in = 0, out = 0, weighted = 0, size = 1;
  PMPI_Comm_size(c, &size);
  if (size <= 1) return;
  PMPI_Dist_graph_neighbors_count(c, &in, &out, &weighted);
  int *from = malloc((size_t)(2 * in + 1) * sizeof(int));
  int *to = malloc((size_t)(2 * out + 1) * sizeof(int));
  PMPI_Dist_graph_neighbors(c, in, from, from + in, out, to, to + out);
  for (int i = 0; i < out; i++) sent(each ? each[i] : bytes, world_rank(to[i], c));
  free(from);
  free(to);
}

static int neighbours_of(MPI_Comm c) {
  int in = 0, out = 0, weighted = 0;
  PMPI_Dist_graph_neighbors_count(c, &in, &out, &weighted);
  return out;
}

// The functions with counts, which come in two kinds: of ints, and since MPI 4 of MPI_Counts (…_c).

#define SEND(NAME, S, N)                                                                           \
  int MPI_##NAME##S(const void *b, N n, MPI_Datatype t, int to, int tag, MPI_Comm c) {             \
    send_counted(n, t, to, c);                                                                     \
    return PMPI_##NAME##S(b, n, t, to, tag, c);                                                    \
  }

#define ISEND(NAME, S, N)                                                                          \
  int MPI_##NAME##S(const void *b, N n, MPI_Datatype t, int to, int tag, MPI_Comm c,               \
                    MPI_Request *r) {                                                              \
    send_counted(n, t, to, c);                                                                     \
    return PMPI_##NAME##S(b, n, t, to, tag, c, r);                                                 \
  }

#define INIT(NAME, S, N)                                                                           \
  int MPI_##NAME##S(const void *b, N n, MPI_Datatype t, int to, int tag, MPI_Comm c,               \
                    MPI_Request *r) {                                                              \
    int error = PMPI_##NAME##S(b, n, t, to, tag, c, r), size = 1;                                  \
    PMPI_Comm_size(c, &size);                                                                      \
    if (to != MPI_PROC_NULL && size > 1) keep(*r, size_of(n, t), world_rank(to, c));               \
    return error;                                                                                  \
  }

#define REDUCE(NAME, S, N)                                                                         \
  int MPI_##NAME##S(const void *b, void *rb, N n, MPI_Datatype t, MPI_Op o, MPI_Comm c) {          \
    collective(size_of(n, t), c);                                                                  \
    return PMPI_##NAME##S(b, rb, n, t, o, c);                                                      \
  }

#define GATHER(NAME, S, N)                                                                         \
  int MPI_##NAME##S(const void *b, N n, MPI_Datatype t, void *rb, N rn, MPI_Datatype rt, int root, \
                    MPI_Comm c) {                                                                  \
    collective(b == MPI_IN_PLACE ? 0 : size_of(n, t), c);                                          \
    return PMPI_##NAME##S(b, n, t, rb, rn, rt, root, c);                                           \
  }

#define NEIGHBOURS_V(NAME, S, N, D, MORE, LAST)                                                    \
  int MPI_##NAME##S(const void *b, const N *n, const D *d, MPI_Datatype t, void *rb, const N *rn,  \
                    const D *rd, MPI_Datatype rt, MPI_Comm c MORE) {                               \
    int out = neighbours_of(c);                                                                    \
    double *each = malloc((size_t)(out + 1) * sizeof(double));                                     \
    for (int i = 0; i < out; i++) each[i] = size_of(n[i], t);                                      \
    to_neighbours(0, each, c);                                                                     \
    free(each);                                                                                    \
    return PMPI_##NAME##S(b, n, d, t, rb, rn, rd, rt, c LAST);                                     \
  }
#define COMMA ,

#define FUNCTIONS(S, N, D)                                                                         \
  SEND(Send, S, N)                                                                                 \
  SEND(Ssend, S, N)                                                                                \
  SEND(Bsend, S, N)                                                                                \
  SEND(Rsend, S, N)                                                                                \
  ISEND(Isend, S, N)                                                                               \
  ISEND(Issend, S, N)                                                                              \
  ISEND(Ibsend, S, N)                                                                              \
  ISEND(Irsend, S, N)                                                                              \
  INIT(Send_init, S, N)                                                                            \
  INIT(Ssend_init, S, N)                                                                           \
  INIT(Rsend_init, S, N)                                                                           \
  INIT(Bsend_init, S, N)                                                                           \
  REDUCE(Allreduce, S, N)                                                                          \
  REDUCE(Scan, S, N)                                                                               \
  REDUCE(Exscan, S, N)                                                                             \
  GATHER(Gather, S, N)                                                                             \
  GATHER(Scatter, S, N)                                                                            \
  NEIGHBOURS_V(Neighbor_alltoallv, S, N, D, , )                                                    \
  NEIGHBOURS_V(Ineighbor_alltoallv, S, N, D, COMMA MPI_Request * r, COMMA r)                       \
  int MPI_Sendrecv##S(const void *b, N n, MPI_Datatype t, int to, int tag, void *rb, N rn,         \
                      MPI_Datatype rt, int from, int rtag, MPI_Comm c, MPI_Status *s) {            \
    send_counted(n, t, to, c);                                                                     \
    return PMPI_Sendrecv##S(b, n, t, to, tag, rb, rn, rt, from, rtag, c, s);                       \
  }                                                                                                \
  int MPI_Bcast##S(void *b, N n, MPI_Datatype t, int root, MPI_Comm c) {                           \
    int rank = 0;                                                                                  \
    PMPI_Comm_rank(c, &rank);                                                                      \
    collective(rank == root ? size_of(n, t) : 0, c);                                               \
    return PMPI_Bcast##S(b, n, t, root, c);                                                        \
  }                                                                                                \
  int MPI_Iallreduce##S(const void *b, void *rb, N n, MPI_Datatype t, MPI_Op o, MPI_Comm c,        \
                        MPI_Request *r) {                                                          \
    collective(size_of(n, t), c);                                                                  \
    return PMPI_Iallreduce##S(b, rb, n, t, o, c, r);                                               \
  }                                                                                                \
  int MPI_Reduce##S(const void *b, void *rb, N n, MPI_Datatype t, MPI_Op o, int root,              \
                    MPI_Comm c) {                                                                  \
    collective(size_of(n, t), c);                                                                  \
    return PMPI_Reduce##S(b, rb, n, t, o, root, c);                                                \
  }                                                                                                \
  int MPI_Reduce_scatter_block##S(const void *b, void *rb, N n, MPI_Datatype t, MPI_Op o,          \
                                  MPI_Comm c) {                                                    \
    int size = 1;                                                                                  \
    PMPI_Comm_size(c, &size);                                                                      \
    collective(size * size_of(n, t), c);                                                           \
    return PMPI_Reduce_scatter_block##S(b, rb, n, t, o, c);                                        \
  }                                                                                                \
  int MPI_Gatherv##S(const void *b, N n, MPI_Datatype t, void *rb, const N *rn, const D *d,        \
                     MPI_Datatype rt, int root, MPI_Comm c) {                                      \
    collective(b == MPI_IN_PLACE ? 0 : size_of(n, t), c);                                          \
    return PMPI_Gatherv##S(b, n, t, rb, rn, d, rt, root, c);                                       \
  }                                                                                                \
  int MPI_Allgather##S(const void *b, N n, MPI_Datatype t, void *rb, N rn, MPI_Datatype rt,        \
                       MPI_Comm c) {                                                               \
    collective(b == MPI_IN_PLACE ? 0 : size_of(n, t), c);                                          \
    return PMPI_Allgather##S(b, n, t, rb, rn, rt, c);                                              \
  }                                                                                                \
  int MPI_Allgatherv##S(const void *b, N n, MPI_Datatype t, void *rb, const N *rn, const D *d,     \
                        MPI_Datatype rt, MPI_Comm c) {                                             \
    collective(b == MPI_IN_PLACE ? 0 : size_of(n, t), c);                                          \
    return PMPI_Allgatherv##S(b, n, t, rb, rn, d, rt, c);                                          \
  }                                                                                                \
  int MPI_Iallgatherv##S(const void *b, N n, MPI_Datatype t, void *rb, const N *rn, const D *d,    \
                         MPI_Datatype rt, MPI_Comm c, MPI_Request *r) {                            \
    collective(b == MPI_IN_PLACE ? 0 : size_of(n, t), c);                                          \
    return PMPI_Iallgatherv##S(b, n, t, rb, rn, d, rt, c, r);                                      \
  }                                                                                                \
  int MPI_Igatherv##S(const void *b, N n, MPI_Datatype t, void *rb, const N *rn, const D *d,       \
                      MPI_Datatype rt, int root, MPI_Comm c, MPI_Request *r) {                     \
    collective(b == MPI_IN_PLACE ? 0 : size_of(n, t), c);                                          \
    return PMPI_Igatherv##S(b, n, t, rb, rn, d, rt, root, c, r);                                   \
  }                                                                                                \
  int MPI_Iscatterv##S(const void *b, const N *n, const D *d, MPI_Datatype t, void *rb, N rn,      \
                       MPI_Datatype rt, int root, MPI_Comm c, MPI_Request *r) {                    \
    collective(0, c);                                                                              \
    return PMPI_Iscatterv##S(b, n, d, t, rb, rn, rt, root, c, r);                                  \
  }                                                                                                \
  int MPI_Alltoall##S(const void *b, N n, MPI_Datatype t, void *rb, N rn, MPI_Datatype rt,         \
                      MPI_Comm c) {                                                                \
    int size = 1;                                                                                  \
    PMPI_Comm_size(c, &size);                                                                      \
    collective(b == MPI_IN_PLACE ? 0 : size * size_of(n, t), c);                                   \
    return PMPI_Alltoall##S(b, n, t, rb, rn, rt, c);                                               \
  }                                                                                                \
  int MPI_Alltoallv##S(const void *b, const N *n, const D *d, MPI_Datatype t, void *rb,            \
                       const N *rn, const D *rd, MPI_Datatype rt, MPI_Comm c) {                    \
    int size = 1;                                                                                  \
    double total = 0;                                                                              \
    PMPI_Comm_size(c, &size);                                                                      \
    for (int i = 0; b != MPI_IN_PLACE && i < size; i++) total += size_of(n[i], t);                 \
    collective(total, c);                                                                          \
    return PMPI_Alltoallv##S(b, n, d, t, rb, rn, rd, rt, c);                                       \
  }                                                                                                \
  int MPI_Neighbor_alltoall##S(const void *b, N n, MPI_Datatype t, void *rb, N rn,                 \
                               MPI_Datatype rt, MPI_Comm c) {                                      \
    to_neighbours(size_of(n, t), NULL, c);                                                         \
    return PMPI_Neighbor_alltoall##S(b, n, t, rb, rn, rt, c);                                      \
  }

FUNCTIONS(, int, int)
#if MPI_VERSION >= 4
FUNCTIONS(_c, MPI_Count, MPI_Aint)
#endif
