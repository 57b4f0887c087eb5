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
    uint32_t data, mask, resp, addr;
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

// What the sound design read where the script says `c`, in this order.
std::vector<uint32_t> learned;

class Host {
  public:
    explicit Host(uint32_t fault) : fault_{fault} {
        context_.randReset(2);
        context_.randSeed(SEED);
        dut_ = std::make_unique<Vpearl_backbone>(&context_);
        dut_->mutant_i = fault;
        dut_->req_i = 0;
        reset(RESET_CYCLES);
    }
    ~Host() { dut_->final(); }

    bool run(const Part& part) {
        for (const Op& op : part.ops) {
            switch (op.kind) {
                case 'w': request(op, true); break;
                case 'r':
                case 'c': request(op, false); break;
                case 'n':
                    for (uint32_t i = 0; i < op.addr; i++) tick({});
                    break;
                case 'i':  // the interrupt comes within so many cycles
                    for (uint32_t i = 0; !dut_->irq_o && i < op.addr; i++) tick({});
                    if (!dut_->irq_o) { if(fault_==0) fprintf(stderr,"no irq\n"); return false; }
                    break;
                case 'q':  // the interrupt as it is now
                    if (dut_->irq_o != op.addr) return false;
                    break;
                case 'x': reset(op.addr); break;
            }
            if (!right_) return false;
        }
        for (int i = 0; i < PORT_LATENCY + 1; i++) tick({});
        return right_;
    }

  private:
    void request(const Op& op, bool write) {
        dut_->req_i = 1;
        dut_->we_i = write;
        dut_->addr_i = op.addr;
        dut_->wdata_i = op.data;
        tick({true, op.kind == 'c', op.data, op.mask, op.resp, op.addr});
        dut_->req_i = 0;
    }

    void tick(const Answer& asked) {
        dut_->clk_i = 0;
        dut_->eval();
        const Answer answer = pending_[PORT_LATENCY - 1];
        if (!resetting_) check(answer);
        for (int i = PORT_LATENCY - 1; i > 0; i--) pending_[i] = pending_[i - 1];
        pending_[0] = asked;
        dut_->clk_i = 1;
        dut_->eval();
    }

    void check(const Answer& answer) {
        if (dut_->rvalid_o != answer.wanted) right_ = false;
        if (!answer.wanted) return;
        if (fault_==0 && (dut_->resp_o != answer.resp || ((dut_->rdata_o & answer.mask) != (answer.data & answer.mask))) && !answer.learn) fprintf(stderr,"addr %x data %x wanted %x mask %x resp %x wanted %x\n", answer.addr, dut_->rdata_o, answer.data, answer.mask, dut_->resp_o, answer.resp);
        if (dut_->resp_o != answer.resp) right_ = false;
        if (answer.learn) {
            if (fault_ == 0) learned.push_back(dut_->rdata_o);
            else if (dut_->rdata_o != learned[learned_++]) right_ = false;
        } else if ((dut_->rdata_o & answer.mask) != (answer.data & answer.mask)) {
            right_ = false;
        }
    }

    void reset(uint32_t cycles) {
        resetting_ = true;
        dut_->rst_ni = 0;
        for (uint32_t i = 0; i < cycles; i++) tick({});
        dut_->rst_ni = 1;
        resetting_ = false;
    }

    const uint32_t fault_;
    VerilatedContext context_;
    std::unique_ptr<Vpearl_backbone> dut_;
    Answer pending_[PORT_LATENCY] = {};
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
    std::printf("0 %s\n", broken_part(0, parts).c_str());
    for (int fault = first; fault <= last; fault++) {
        std::printf("%d %s\n", fault, broken_part(fault, parts).c_str());
        std::fflush(stdout);
    }
}
