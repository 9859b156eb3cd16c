// The two loops of a time step in C++, on the particles and neighbor lists of a run of granflow: kick and drift, and
// particle contacts in batches. Same layout, chunks and arithmetic (Hertz with damping, Mindlin friction with history,
// float64), but no walls, no exact sums, no energies and no checks besides the displacement since the rebuild.
//
//     loops FILE THREADS        prints the median seconds of each loop in one step, as JSON; loops.py writes the file

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <omp.h>
#include <vector>

constexpr int BATCH = 128;  // contacts of a batch
constexpr int LONGEST = 1024 + 24;  // length of a column; a multiple of 4096 bytes apart, columns evict each other
constexpr double SHORTEST = 1.0;  // s, of the measurement

struct Particle { double position[3], radius, mass, velocity[3], spin[3], velocity_now[3]; };
struct Load { double force[3], torque[3]; };
struct Rebuilt { double position[3], reach; };
struct Law { double dt, modulus, shear_modulus, viscosity, friction; };

// A column per number of a contact; force and torques replace inputs, as in engine/batch.py.
struct Batch {
    int owner[LONGEST], partner[LONGEST], entry[LONGEST];
    alignas(64) double radius[2][LONGEST], mass[2][LONGEST], branch[3][LONGEST], half[3][LONGEST], now[3][LONGEST];
    alignas(64) double spin[2][3][LONGEST], spring[3][LONGEST];
};

static void kick_and_drift(Particle* particles, const Load* loads, const Rebuilt* rebuilt, int first, int end, double dt,
                           int* due) {
    for (int i = first; i < end; i++) {
        Particle& p = particles[i];
        double share = dt / p.mass, share_spin = dt / (0.4 * p.mass * p.radius * p.radius), moved = 0.0;
        for (int k = 0; k < 3; k++) {
            double kick = share * loads[i].force[k];
            p.velocity[k] += kick;
            p.velocity_now[k] = p.velocity[k] + 0.5 * kick;
            p.position[k] += dt * p.velocity[k];
            p.spin[k] += share_spin * loads[i].torque[k];
            double change = p.position[k] - rebuilt[i].position[k];
            moved += change * change;
        }
        if (moved > rebuilt[i].reach * rebuilt[i].reach) *due = 1;
    }
}

static void evaluate(Batch& b, int count, const Law& law) {
    const double dt = law.dt, stiffness = 4.0 / 3.0 * law.modulus, shear = 8.0 * law.shear_modulus;
#pragma GCC ivdep
    for (int e = 0; e < count; e++) {
        double x = b.branch[0][e], y = b.branch[1][e], z = b.branch[2][e];
        double hx = b.half[0][e], hy = b.half[1][e], hz = b.half[2][e];
        double ra = b.radius[0][e], rb = b.radius[1][e], ma = b.mass[0][e], mb = b.mass[1][e];
        double radius = ra * rb / (ra + rb), mass = ma * mb / (ma + mb);
        double distance = std::sqrt(x * x + y * y + z * z), inverse = 1.0 / distance, overlap = ra + rb - distance;
        x *= inverse, y *= inverse, z *= inverse;
        // normal and lever arms of the half step, the time of the velocities
        double apart = hx * x + hy * y + hz * z, turn = 0.5 * dt * inverse;
        double px = x - turn * (hx - apart * x), py = y - turn * (hy - apart * y), pz = z - turn * (hz - apart * z);
        double arm_a = ra - 0.5 * overlap, arm_b = rb - 0.5 * overlap;
        double shift = -0.25 * dt * apart, apart_half = hx * px + hy * py + hz * pz;
        // Hertz with Tsuji's damping, averaged over the step
        double rate = -(b.now[0][e] * x + b.now[1][e] * y + b.now[2][e] * z);
        double root = std::sqrt(radius * overlap), elastic = stiffness * root * overlap, travel = std::fabs(rate) * dt;
        bool begins = overlap <= 1.000001 * rate * dt;
        double at = begins ? overlap + 0.5 * travel : overlap;
        double ratio = (begins ? at : (travel < overlap ? travel : overlap)) / (begins ? travel : overlap);
        double weight = begins ? 0.8 * ratio : 1.0 - 0.0078125 * ratio * ratio;
        double damping = law.viscosity * weight * std::sqrt(mass * stiffness * std::sqrt(radius * at)) * rate;
        double normal = elastic + (damping > -elastic ? damping : -elastic);
        // Mindlin: slip in this step, displacement of the spring in the present contact plane, Coulomb's limit
        double before = overlap + dt * apart_half;
        double carried = std::sqrt((before > 0.0 ? before : 0.0) / overlap);
        carried = carried < 1.0 ? carried : 1.0;
        double wx = b.spin[0][0][e] * (arm_a + shift) + b.spin[1][0][e] * (arm_b + shift);
        double wy = b.spin[0][1][e] * (arm_a + shift) + b.spin[1][1][e] * (arm_b + shift);
        double wz = b.spin[0][2][e] * (arm_a + shift) + b.spin[1][2][e] * (arm_b + shift);
        double ux = hx - (wy * pz - wz * py), uy = hy - (wz * px - wx * pz), uz = hz - (wx * py - wy * px);
        double along = ux * x + uy * y + uz * z;
        double sx = b.spring[0][e], sy = b.spring[1][e], sz = b.spring[2][e], out = sx * x + sy * y + sz * z;
        sx = carried * (sx - out * px) + dt * (ux - along * px);
        sy = carried * (sy - out * py) + dt * (uy - along * py);
        sz = carried * (sz - out * pz) + dt * (uz - along * pz);
        double tangential = -shear * root, fx = tangential * sx, fy = tangential * sy, fz = tangential * sz;
        double square = fx * fx + fy * fy + fz * fz, cap = law.friction * normal;
        double limit = square > cap * cap ? cap / std::sqrt(square) : 1.0;
        fx *= limit, fy *= limit, fz *= limit;
        double mx = y * fz - z * fy, my = z * fx - x * fz, mz = x * fy - y * fx;
        b.branch[0][e] = normal * x + fx, b.branch[1][e] = normal * y + fy, b.branch[2][e] = normal * z + fz;
        b.spin[0][0][e] = -arm_a * mx, b.spin[0][1][e] = -arm_a * my, b.spin[0][2][e] = -arm_a * mz;
        b.spin[1][0][e] = -arm_b * mx, b.spin[1][1][e] = -arm_b * my, b.spin[1][2][e] = -arm_b * mz;
        b.spring[0][e] = limit * sx, b.spring[1][e] = limit * sy, b.spring[2][e] = limit * sz;
    }
}

struct Run {
    std::int64_t count, entries, chunk;
    Law law;
    std::vector<Particle> particles;
    std::vector<Load> loads;
    std::vector<Rebuilt> rebuilt;
    std::vector<double> spring;  // three components per entry
    std::vector<int> begin, end, partner, touching;

    void contacts(Batch& b, int first, int last) {
        for (int i = first; i < last; i++) loads[i] = {{0.0, 0.0, -9.81 * particles[i].mass}, {0.0, 0.0, 0.0}};
        for (int i = first; i < last;) {
            int count = 0;
            while (i < last && count < BATCH) count = collect(b, i++, count);
            for (int e = 0; e < count; e++) gather(b, e);
            evaluate(b, count, law);
            for (int e = 0; e < count; e++) scatter(b, e, first, last);
        }
    }

    int collect(Batch& b, int i, int count) {
        const Particle& p = particles[i];
        for (int entry = begin[i]; entry < end[i]; entry++) {
            int j = partner[entry];
            const Particle& q = particles[j];
            double square = 0.0, reach = p.radius + q.radius;
            for (int k = 0; k < 3; k++) {
                b.branch[k][count] = p.position[k] - q.position[k];
                square += b.branch[k][count] * b.branch[k][count];
            }
            b.owner[count] = i, b.partner[count] = j, b.entry[count] = entry;
            bool touches = square < reach * reach;
            if (touching[entry] && !touches) {  // the contact ends
                touching[entry] = 0;
                for (int k = 0; k < 3; k++) spring[3 * entry + k] = 0.0;
            }
            count += touches;
        }
        return count;
    }

    void gather(Batch& b, int e) {
        const Particle &p = particles[b.owner[e]], &q = particles[b.partner[e]];
        b.radius[0][e] = p.radius, b.radius[1][e] = q.radius, b.mass[0][e] = p.mass, b.mass[1][e] = q.mass;
        for (int k = 0; k < 3; k++) {
            b.half[k][e] = p.velocity[k] - q.velocity[k];
            b.now[k][e] = p.velocity_now[k] - q.velocity_now[k];
            b.spin[0][k][e] = p.spin[k], b.spin[1][k][e] = q.spin[k];
            b.spring[k][e] = spring[3 * b.entry[e] + k];
        }
    }

    void scatter(const Batch& b, int e, int first, int last) {
        Load& p = loads[b.owner[e]];
        for (int k = 0; k < 3; k++) {
            p.force[k] += b.branch[k][e], p.torque[k] += b.spin[0][k][e];
            spring[3 * b.entry[e] + k] = b.spring[k][e];
        }
        touching[b.entry[e]] = 1;
        if (b.partner[e] < first || b.partner[e] >= last) return;  // that chunk evaluates the pair, too
        Load& q = loads[b.partner[e]];
        for (int k = 0; k < 3; k++) q.force[k] -= b.branch[k][e], q.torque[k] += b.spin[1][k][e];
    }
};

static double median(std::vector<double>& values) {
    std::nth_element(values.begin(), values.begin() + values.size() / 2, values.end());
    return values[values.size() / 2];
}

int main(int, char** words) {
    Run run;
    std::ifstream file(words[1], std::ios::binary);
    file.read(reinterpret_cast<char*>(&run.count), 3 * sizeof(std::int64_t));
    file.read(reinterpret_cast<char*>(&run.law), sizeof(Law));
    auto read = [&](auto& array, std::int64_t length) {
        array.resize(length);
        file.read(reinterpret_cast<char*>(array.data()), length * sizeof(array[0]));
    };
    read(run.particles, run.count);
    read(run.rebuilt, run.count);
    read(run.spring, 3 * run.entries);
    read(run.begin, run.count);
    read(run.end, run.count);
    read(run.partner, run.entries);
    if (!file) return 1;
    run.loads.resize(run.count);
    run.touching.assign(run.entries, 0);
    omp_set_num_threads(std::atoi(words[2]));
    const int chunks = static_cast<int>((run.count + run.chunk - 1) / run.chunk);
    std::vector<Batch> batches(omp_get_max_threads());
    int due = 0;
    std::vector<double> seconds[2];
    double began = omp_get_wtime();
    while (seconds[1].size() < 10 || omp_get_wtime() - began < SHORTEST) {
        for (int phase = 0; phase < 2; phase++) {
            double start = omp_get_wtime();
#pragma omp parallel for schedule(dynamic)
            for (int chunk = 0; chunk < chunks; chunk++) {
                int first = static_cast<int>(chunk * run.chunk);
                int last = static_cast<int>(std::min(first + run.chunk, run.count));
                if (phase)
                    run.contacts(batches[omp_get_thread_num()], first, last);
                else  // without motion, so that the pairs remain those of the run
                    kick_and_drift(run.particles.data(), run.loads.data(), run.rebuilt.data(), first, last, 0.0, &due);
            }
            seconds[phase].push_back(omp_get_wtime() - start);
        }
    }
    double sum = 0.0;
    for (const Load& load : run.loads) sum += load.force[2];
    std::printf("{\"integration\": %.9g, \"forces\": %.9g, \"force_z\": %.9g}\n", median(seconds[0]),
                median(seconds[1]), sum);
}
