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

static double size_of(int count, MPI_Datatype type) {
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

static void send_counted(int count, MPI_Datatype type, int to, MPI_Comm comm) {
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

#define SEND(NAME)                                                                                  \
  int MPI_##NAME(const void *b, int n, MPI_Datatype t, int to, int tag, MPI_Comm c) {               \
    send_counted(n, t, to, c);                                                                      \
    return PMPI_##NAME(b, n, t, to, tag, c);                                                        \
  }
SEND(Send)
SEND(Ssend)
SEND(Bsend)
SEND(Rsend)

#define ISEND(NAME)                                                                                 \
  int MPI_##NAME(const void *b, int n, MPI_Datatype t, int to, int tag, MPI_Comm c,                 \
                 MPI_Request *r) {                                                                  \
    send_counted(n, t, to, c);                                                                      \
    return PMPI_##NAME(b, n, t, to, tag, c, r);                                                     \
  }
ISEND(Isend)
ISEND(Issend)
ISEND(Ibsend)
ISEND(Irsend)

int MPI_Sendrecv(const void *b, int n, MPI_Datatype t, int to, int tag, void *rb, int rn,
                 MPI_Datatype rt, int from, int rtag, MPI_Comm c, MPI_Status *s) {
  send_counted(n, t, to, c);
  return PMPI_Sendrecv(b, n, t, to, tag, rb, rn, rt, from, rtag, c, s);
}

static void keep(MPI_Request request, double bytes, int to) {
  if (n_kept == room) {
    room = room ? 2 * room : 64;
    kept = realloc(kept, (size_t)room * sizeof *kept);
  }
  kept[n_kept++] = (Persistent){request, bytes, to};
}

#define INIT(NAME)                                                                                  \
  int MPI_##NAME(const void *b, int n, MPI_Datatype t, int to, int tag, MPI_Comm c,                 \
                 MPI_Request *r) {                                                                  \
    int error = PMPI_##NAME(b, n, t, to, tag, c, r), size = 1;                                      \
    PMPI_Comm_size(c, &size);                                                                       \
    if (to != MPI_PROC_NULL && size > 1) keep(*r, size_of(n, t), world_rank(to, c));                \
    return error;                                                                                   \
  }
INIT(Send_init)
INIT(Ssend_init)
INIT(Rsend_init)
INIT(Bsend_init)

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

int MPI_Bcast(void *b, int n, MPI_Datatype t, int root, MPI_Comm c) {
  int rank = 0;
  PMPI_Comm_rank(c, &rank);
  collective(rank == root ? size_of(n, t) : 0, c);
  return PMPI_Bcast(b, n, t, root, c);
}

int MPI_Allreduce(const void *b, void *rb, int n, MPI_Datatype t, MPI_Op o, MPI_Comm c) {
  collective(size_of(n, t), c);
  return PMPI_Allreduce(b, rb, n, t, o, c);
}

int MPI_Iallreduce(const void *b, void *rb, int n, MPI_Datatype t, MPI_Op o, MPI_Comm c,
                   MPI_Request *r) {
  collective(size_of(n, t), c);
  return PMPI_Iallreduce(b, rb, n, t, o, c, r);
}

int MPI_Reduce(const void *b, void *rb, int n, MPI_Datatype t, MPI_Op o, int root, MPI_Comm c) {
  collective(size_of(n, t), c);
  return PMPI_Reduce(b, rb, n, t, o, root, c);
}

int MPI_Scan(const void *b, void *rb, int n, MPI_Datatype t, MPI_Op o, MPI_Comm c) {
  collective(size_of(n, t), c);
  return PMPI_Scan(b, rb, n, t, o, c);
}

int MPI_Exscan(const void *b, void *rb, int n, MPI_Datatype t, MPI_Op o, MPI_Comm c) {
  collective(size_of(n, t), c);
  return PMPI_Exscan(b, rb, n, t, o, c);
}

int MPI_Reduce_scatter_block(const void *b, void *rb, int n, MPI_Datatype t, MPI_Op o, MPI_Comm c) {
  int size = 1;
  PMPI_Comm_size(c, &size);
  collective(size * size_of(n, t), c);
  return PMPI_Reduce_scatter_block(b, rb, n, t, o, c);
}

#define GATHER(NAME)                                                                                \
  int MPI_##NAME(const void *b, int n, MPI_Datatype t, void *rb, int rn, MPI_Datatype rt, int root, \
                 MPI_Comm c) {                                                                      \
    collective(b == MPI_IN_PLACE ? 0 : size_of(n, t), c);                                           \
    return PMPI_##NAME(b, n, t, rb, rn, rt, root, c);                                               \
  }
GATHER(Gather)
GATHER(Scatter)

int MPI_Gatherv(const void *b, int n, MPI_Datatype t, void *rb, const int *rn, const int *d,
                MPI_Datatype rt, int root, MPI_Comm c) {
  collective(b == MPI_IN_PLACE ? 0 : size_of(n, t), c);
  return PMPI_Gatherv(b, n, t, rb, rn, d, rt, root, c);
}

int MPI_Allgather(const void *b, int n, MPI_Datatype t, void *rb, int rn, MPI_Datatype rt,
                  MPI_Comm c) {
  collective(b == MPI_IN_PLACE ? 0 : size_of(n, t), c);
  return PMPI_Allgather(b, n, t, rb, rn, rt, c);
}

int MPI_Allgatherv(const void *b, int n, MPI_Datatype t, void *rb, const int *rn, const int *d,
                   MPI_Datatype rt, MPI_Comm c) {
  collective(b == MPI_IN_PLACE ? 0 : size_of(n, t), c);
  return PMPI_Allgatherv(b, n, t, rb, rn, d, rt, c);
}

int MPI_Alltoall(const void *b, int n, MPI_Datatype t, void *rb, int rn, MPI_Datatype rt,
                 MPI_Comm c) {
  int size = 1;
  PMPI_Comm_size(c, &size);
  collective(b == MPI_IN_PLACE ? 0 : size * size_of(n, t), c);
  return PMPI_Alltoall(b, n, t, rb, rn, rt, c);
}

int MPI_Alltoallv(const void *b, const int *n, const int *d, MPI_Datatype t, void *rb,
                  const int *rn, const int *rd, MPI_Datatype rt, MPI_Comm c) {
  int size = 1, total = 0;
  PMPI_Comm_size(c, &size);
  for (int i = 0; b != MPI_IN_PLACE && i < size; i++) total += n[i];
  collective(size_of(total, t), c);
  return PMPI_Alltoallv(b, n, d, t, rb, rn, rd, rt, c);
}

// Between neighbours: a message to each of them.

static void to_neighbours(const int *n, int count, MPI_Datatype t, MPI_Comm c) {
  int in = 0, out = 0, weighted = 0, size = 1;
  PMPI_Comm_size(c, &size);
  if (size <= 1) return;
  PMPI_Dist_graph_neighbors_count(c, &in, &out, &weighted);
  int *from = malloc((size_t)(2 * in + 1) * sizeof(int));
  int *to = malloc((size_t)(2 * out + 1) * sizeof(int));
  PMPI_Dist_graph_neighbors(c, in, from, from + in, out, to, to + out);
  for (int i = 0; i < out; i++) sent(size_of(n ? n[i] : count, t), world_rank(to[i], c));
  free(from);
  free(to);
}

int MPI_Neighbor_alltoall(const void *b, int n, MPI_Datatype t, void *rb, int rn, MPI_Datatype rt,
                          MPI_Comm c) {
  to_neighbours(NULL, n, t, c);
  return PMPI_Neighbor_alltoall(b, n, t, rb, rn, rt, c);
}

int MPI_Neighbor_alltoallv(const void *b, const int *n, const int *d, MPI_Datatype t, void *rb,
                           const int *rn, const int *rd, MPI_Datatype rt, MPI_Comm c) {
  to_neighbours(n, 0, t, c);
  return PMPI_Neighbor_alltoallv(b, n, d, t, rb, rn, rd, rt, c);
}

int MPI_Ineighbor_alltoallv(const void *b, const int *n, const int *d, MPI_Datatype t, void *rb,
                            const int *rn, const int *rd, MPI_Datatype rt, MPI_Comm c,
                            MPI_Request *r) {
  to_neighbours(n, 0, t, c);
  return PMPI_Ineighbor_alltoallv(b, n, d, t, rb, rn, rd, rt, c, r);
}
