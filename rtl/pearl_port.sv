// SPDX-License-Identifier: MIT
// The address space behind one memory port: finds a request's region, refuses what is not allowed,
// and collects the answer, PORT_LATENCY cycles after the request. A request a cycle.
//
// While a step runs, only results, doorbell, status and control can be read, and nothing written but
// the word that resets. Whether one runs is asked in the cycle before the access, when a doorbell that was
// the request before has yet to ring: it is taken for one that does.
module pearl_port
  import pearl_pkg::*;
#(
    parameter int unsigned DATA_WL = 32,
    // Bits of a word's address.
    parameter int unsigned WORD_ADDR_BITS = 8,
    // The address of each region's first word, and at the end that of the first hole.
    parameter int unsigned OFFSETS[NumRegions+1] = '{default: 0}
) (
    input logic clk_i,
    input logic rst_ni,

    input  logic                       req_i,
    input  logic                       we_i,
    // A read for the sake of a write: of the word that the next request changes a part of.
    input  logic                       fetch_i,
    input  logic  [WORD_ADDR_BITS-1:0] addr_i,
    input  logic  [       DATA_WL-1:0] wdata_i,
    output logic                       rvalid_o,
    output logic  [       DATA_WL-1:0] rdata_o,
    output resp_e                      resp_o,

    // A step runs, or the pipeline drains.
    input  logic                                   busy_i,
    output logic [    NumRegions-1:0]              re_o,
    output logic [    NumRegions-1:0]              we_o,
    // The word's number within its region.
    output logic [WORD_ADDR_BITS-1:0]              index_o,
    output logic [       DATA_WL-1:0]              wdata_o,
    // The same a cycle before, for what takes longer to look at.
    output logic [       DATA_WL-1:0]              next_wdata_o,
    // READ_LATENCY cycles after re_o.
    input  logic [    NumRegions-1:0][DATA_WL-1:0] rdata_i,
    // A cycle later, from regions that answer here and not there; zero where none of them was read.
    input  logic [       DATA_WL-1:0]              late_rdata_i,

    // In the cycle of the access: a write, or a doorbell, is refused because a step is running.
    output logic busy_write_o,
    output logic busy_doorbell_o,
    // The first word of results is read, and no step runs.
    output logic untorn_o,
    // The word that resets is written, and not with zero.
    output logic soft_reset_o
);

  localparam logic [NumRegions-1:0] RESULTS = NumRegions'(1 << Observations | 1 << Rewards | 1 << Ters);
  localparam logic [NumRegions-1:0] READ_ONLY = RESULTS | NumRegions'(1 << Status | 1 << Statistics);
  // What the pipeline does not use, so that it can be read at any time.
  localparam logic [NumRegions-1:0] SHARED = READ_ONLY | NumRegions'(1 << Control | 1 << Doorbell);
  localparam int unsigned RESET_INDEX = word_index(CONTROL_RESET, DATA_WL);
  localparam int unsigned SEQUENCE_INDEX = word_index(1, DATA_WL);

  // One more than an address has: the last region may end where the address space does.
  localparam int unsigned BOUND_BITS = WORD_ADDR_BITS + 1;

  typedef struct packed {
    logic write;
    logic fetch;
    logic [WORD_ADDR_BITS-1:0] addr;
    logic [DATA_WL-1:0] wdata;
  } request_t;

  // Whether a request came one cycle ago, two, and so on.
  logic [PORT_LATENCY:1] valid_q;

  always_ff @(posedge clk_i) begin
    if (!rst_ni) valid_q <= '0;
    else valid_q <= {valid_q[PORT_LATENCY-1:1], req_i};
  end

  // ---- Which region it is of ----

  request_t asked_q, located_q;
  logic [NumRegions-1:0] hit, hit_q;
  logic at_reset;
  logic at_first_q, at_reset_q, at_sequence_q, resets_q;

  always_comb begin
    for (int unsigned i = 0; i < NumRegions; i++) begin
      // A build may lack a region: it is empty then, and takes no hardware.
      hit[i] = OFFSETS[i] != OFFSETS[i+1] && BOUND_BITS'(asked_q.addr) >= BOUND_BITS'(OFFSETS[i]) &&
          BOUND_BITS'(asked_q.addr) < BOUND_BITS'(OFFSETS[i+1]);
    end
  end

  assign at_reset = BOUND_BITS'(asked_q.addr) == BOUND_BITS'(OFFSETS[Control] + RESET_INDEX);

  always_ff @(posedge clk_i) begin
    asked_q       <= '{write: we_i, fetch: fetch_i && !we_i, addr: addr_i, wdata: wdata_i};
    located_q     <= asked_q;
    hit_q         <= hit;
    at_first_q    <= BOUND_BITS'(asked_q.addr) == BOUND_BITS'(OFFSETS[Observations]);
    at_reset_q    <= at_reset;
    at_sequence_q <= BOUND_BITS'(asked_q.addr) == BOUND_BITS'(OFFSETS[Doorbell] + SEQUENCE_INDEX);
    resets_q      <= at_reset && asked_q.write && asked_q.wdata[CONTROL_RESET*32%DATA_WL+:32] != '0;
  end

  // ---- Which word of it, and whether that is allowed ----

  logic req, changes, busy, closed, outdated_q;
  logic [NumRegions-1:0] hit_writable, re, we, re_q, we_q;
  logic hole_q, busy_write_q, busy_doorbell_q, untorn_q, soft_reset_q, sequence_q;
  logic [WORD_ADDR_BITS-1:0] base, index_q;
  logic [DATA_WL-1:0] wdata_q;

  assign req = valid_q[2];
  // A fetch is for a write, and allowed where that is.
  assign changes = located_q.write || located_q.fetch;
  assign hit_writable = hit_q & ~READ_ONLY;
  assign busy = busy_i || soft_reset_q || sequence_q;
  // A part of the word that resets can be written during a step, so that word is fetched then, too. What
  // it held is outdated when the step ends: unless it resets, the write is refused even after that.
  assign closed = (busy || outdated_q) && !resets_q && !(located_q.fetch && at_reset_q);

  always_comb begin
    base = '0;
    for (int unsigned i = 0; i < NumRegions; i++) begin
      if (hit_q[i]) base |= WORD_ADDR_BITS'(OFFSETS[i]);
    end
  end

  always_comb begin
    re = '0;
    we = '0;
    if (located_q.fetch) re = closed ? '0 : hit_writable;
    else if (!located_q.write) re = busy ? hit_q & SHARED : hit_q;
    // What resets during a step does nothing else.
    else
      we = busy || outdated_q ? '0 : hit_writable;
  end

  always_ff @(posedge clk_i) begin
    if (!rst_ni) begin
      re_q            <= '0;
      we_q            <= '0;
      outdated_q      <= 1'b0;
      busy_write_q    <= 1'b0;
      busy_doorbell_q <= 1'b0;
      untorn_q        <= 1'b0;
      soft_reset_q    <= 1'b0;
      sequence_q      <= 1'b0;
    end else begin
      re_q            <= req ? re : '0;
      we_q            <= req ? we : '0;
      busy_write_q    <= req && changes && closed && |hit_writable && !hit_q[Doorbell];
      busy_doorbell_q <= req && changes && closed && hit_q[Doorbell];
      untorn_q        <= req && !changes && !busy && at_first_q;
      soft_reset_q    <= req && resets_q;
      sequence_q      <= req && |we && at_sequence_q;
      if (req) outdated_q <= busy && located_q.fetch && at_reset_q;
    end
  end

  always_ff @(posedge clk_i) begin
    hole_q  <= hit_q == '0;
    index_q <= located_q.addr - base;
    wdata_q <= located_q.wdata;
  end

  assign re_o = re_q;
  assign we_o = we_q;
  assign index_o = index_q;
  assign wdata_o = wdata_q;
  assign next_wdata_o = located_q.wdata;
  assign busy_write_o = busy_write_q;
  assign busy_doorbell_o = busy_doorbell_q;
  assign untorn_o = untorn_q;
  assign soft_reset_o = soft_reset_q;

  // ---- The answer ----

  resp_e resp, resp_q;
  logic [1:0] late_resp;
  logic [NumRegions-1:0] late_re;
  logic [DATA_WL-1:0] early, early_q, rdata_q;

  always_comb begin
    if (hole_q) resp = RespDecErr;
    else if (|{re_q, we_q, soft_reset_q}) resp = RespOkay;
    else resp = RespSlvErr;
  end

  pearl_delay #(
      .WIDTH (NumRegions),
      .STAGES(READ_LATENCY)
  ) u_late_re (
      .clk_i,
      .d_i(re_q),
      .d_o(late_re)
  );
  pearl_delay #(
      .WIDTH (2),
      .STAGES(READ_LATENCY + 1)
  ) u_late_resp (
      .clk_i,
      .d_i(resp),
      .d_o(late_resp)
  );

  always_comb begin
    early = '0;
    for (int unsigned i = 0; i < NumRegions; i++) begin
      if (late_re[i]) early |= rdata_i[i];
    end
  end

  always_ff @(posedge clk_i) begin
    early_q <= early;
    rdata_q <= early_q | late_rdata_i;
    resp_q  <= resp_e'(late_resp);
  end

  assign rvalid_o = valid_q[PORT_LATENCY];
  assign rdata_o  = rdata_q;
  assign resp_o   = resp_q;

  always_ff @(posedge clk_i) begin
    if (rst_ni && valid_q[2]) begin
      assert ($onehot0(hit_q))
      else $error("pearl_port: a word is in two regions");
    end
  end

endmodule
