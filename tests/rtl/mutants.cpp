// Puts one script of a host at the memory port through a design with many faults in it, one fault at a time.
//
// Arguments are the script, the first fault and the last. Fault 0 is none: what it reads where the script says
// `c` is what the others have to read there. Prints a line for each: its number, and the part of the script
// in which an answer was wrong, or `-`.
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <deque>
#include <fstream>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

#include "Vpearl_backbone.h"
#include "verilated.h"

namespace {

struct Op {
    char kind;
    uint32_t addr, data, mask, resp;
};

struct Part {
    std::string name;
    std::vector<Op> ops;
};

struct Answer {
    bool wanted, learn;
    uint32_t data, mask, resp;
};

std::vector<Part> read_script(const char* path) {
    std::ifstream file(path);
    std::vector<Part> parts;
    std::string line;
    while (std::getline(file, line)) {
        std::istringstream words(line);
        char kind;
        words >> kind;
        if (kind == 't') {
            parts.push_back({});
            words >> parts.back().name;
        } else {
            Op op{kind, 0, 0, 0, 0};
            words >> std::hex >> op.addr >> op.data >> op.mask >> op.resp;
            parts.back().ops.push_back(op);
        }
    }
    return parts;
}

// What the sound design read where the script says `c`, in this order; and how many cycles it takes to answer.
std::vector<uint32_t> learned;
size_t latency = 0;

class Host {
  public:
    explicit Host(uint32_t fault) : fault_{fault} {
        context_.randReset(2);
        context_.randSeed(static_cast<int>(fault) + 1);
        dut_ = std::make_unique<Vpearl_backbone>(&context_);
        dut_->mutant_i = fault;
        dut_->req_i = 0;
        dut_->fetch_i = 0;
        reset(1);
        if (fault == 0) latency = measured();
        reset(1);
    }
    ~Host() { dut_->final(); }

    bool run(const Part& part) {
        for (const Op& op : part.ops) {
            switch (op.kind) {
                case 'w': request(op, true); break;
                case 'r':
                case 'f':  // a read for the sake of a write
                case 'c': request(op, false); break;
                case 'n':
                    for (uint32_t i = 0; i < op.addr; i++) tick({});
                    break;
                case 'i':  // the interrupt comes within so many cycles
                    for (uint32_t i = 0; !dut_->irq_o && i < op.addr; i++) tick({});
                    if (!dut_->irq_o) return false;
                    break;
                case 'q':  // the interrupt as it is now
                    if (dut_->irq_o != op.addr) return false;
                    break;
                case 'x': reset(op.addr); break;
            }
            if (!right_) {
                if (fault_ == 0) fprintf(stderr, "%c %x %x %x %x\n", op.kind, op.addr, op.data, op.mask, op.resp);
                return false;
            }
        }
        for (size_t i = 0; i <= latency; i++) tick({});
        return right_;
    }

  private:
    void request(const Op& op, bool write) {
        dut_->req_i = 1;
        dut_->we_i = write;
        dut_->fetch_i = op.kind == 'f';
        dut_->addr_i = op.addr;
        dut_->wdata_i = op.data;
        tick({true, op.kind == 'c', op.data, op.mask, op.resp});
        dut_->req_i = 0;
    }

    void tick(const Answer& asked) {
        dut_->clk_i = 0;
        dut_->eval();
        if (!resetting_) {
            check(pending_.front());
            pending_.pop_front();
            pending_.push_back(asked);
        }
        dut_->clk_i = 1;
        dut_->eval();
    }

    void check(const Answer& answer) {
        if (dut_->rvalid_o != answer.wanted) right_ = false;
        if (!answer.wanted) return;
        if (dut_->resp_o != answer.resp) right_ = false;
        if (answer.learn) {
            if (fault_ == 0) learned.push_back(dut_->rdata_o);
            else if (dut_->rdata_o != learned.at(learned_++)) right_ = false;
        } else if ((dut_->rdata_o & answer.mask) != (answer.data & answer.mask)) {
            right_ = false;
        }
    }

    size_t measured() {
        dut_->req_i = 1;
        dut_->addr_i = 0;
        dut_->we_i = 0;
        for (size_t cycles = 0;; cycles++) {
            dut_->clk_i = 0;
            dut_->eval();
            if (dut_->rvalid_o) return cycles;
            dut_->clk_i = 1;
            dut_->eval();
            dut_->req_i = 0;
        }
    }

    void reset(uint32_t cycles) {
        resetting_ = true;
        dut_->rst_ni = 0;
        for (uint32_t i = 0; i < cycles; i++) tick({});
        dut_->rst_ni = 1;
        resetting_ = false;
        pending_.assign(latency, {});
    }

    const uint32_t fault_;
    VerilatedContext context_;
    std::unique_ptr<Vpearl_backbone> dut_;
    std::deque<Answer> pending_;
    size_t learned_ = 0;
    bool right_ = true, resetting_ = false;
};

std::string broken_part(int fault, const std::vector<Part>& parts) {
    Host host(fault);
    for (const Part& part : parts) {
        if (!host.run(part)) return part.name;
    }
    return "-";
}

}  // namespace

int main(int, char** argv) {
    const std::vector<Part> parts = read_script(argv[1]);
    const int first = std::atoi(argv[2]), last = std::atoi(argv[3]);
    const std::string sound = broken_part(0, parts);
    std::printf("0 %s\n", sound.c_str());
    if (sound != "-") return 0;
    for (int fault = first; fault <= last; fault++) {
        std::printf("%d %s\n", fault, broken_part(fault, parts).c_str());
        std::fflush(stdout);
    }
}
