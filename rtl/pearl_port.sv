// The address space behind one memory port: finds a request's region, refuses what is not allowed,
// and collects the answer, PORT_LATENCY cycles after the request. A request a cycle.
//
// While a step runs, only results, doorbell, status and control can be read, and nothing written.
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
    input  logic  [WORD_ADDR_BITS-1:0] addr_i,
    input  logic  [       DATA_WL-1:0] wdata_i,
    output logic                       rvalid_o,
    output logic  [       DATA_WL-1:0] rdata_o,
    output resp_e                      resp_o,

    input  logic                                   busy_i,
    output logic [    NumRegions-1:0]              re_o,
    output logic [    NumRegions-1:0]              we_o,
    // The word's number within its region.
    output logic [WORD_ADDR_BITS-1:0]              index_o,
    output logic [       DATA_WL-1:0]              wdata_o,
    // In the cycle after re_o.
    input  logic [    NumRegions-1:0][DATA_WL-1:0] rdata_i,

    // A write, or a doorbell, is refused because a step is running.
    output logic busy_write_o,
    output logic busy_doorbell_o,
    // A result is read during a step; the first word of results is read outside of one.
    output logic torn_o,
    output logic untorn_o
);

  localparam logic [NumRegions-1:0] RESULTS = NumRegions'(1 << Observations | 1 << Rewards | 1 << Ters);
  localparam logic [NumRegions-1:0] READ_ONLY = RESULTS | NumRegions'(1 << Status);
  // What the pipeline does not use, so that it can be read at any time.
  localparam logic [NumRegions-1:0] SHARED = READ_ONLY | NumRegions'(1 << Control | 1 << Doorbell);

  // One more than an address has: the last region may end where the address space does.
  localparam int unsigned BOUND_BITS = WORD_ADDR_BITS + 1;

  logic req_q, write_q;
  logic [WORD_ADDR_BITS-1:0] addr_q, base;
  logic [DATA_WL-1:0] wdata_q;
  logic [NumRegions-1:0] hit;

  always_ff @(posedge clk_i or negedge rst_ni) begin
    if (!rst_ni) req_q <= 1'b0;
    else req_q <= req_i;
  end

  always_ff @(posedge clk_i) begin
    if (req_i) begin
      write_q <= we_i;
      addr_q  <= addr_i;
      wdata_q <= wdata_i;
    end
  end

  always_comb begin
    base = '0;
    for (int unsigned i = 0; i < NumRegions; i++) begin
      hit[i] = BOUND_BITS'(addr_q) >= BOUND_BITS'(OFFSETS[i]) &&
          BOUND_BITS'(addr_q) < BOUND_BITS'(OFFSETS[i+1]);
      if (hit[i]) base = WORD_ADDR_BITS'(OFFSETS[i]);
    end
  end

  logic writable, readable;
  resp_e resp;
  assign writable = |(hit & ~READ_ONLY) && !busy_i;
  assign readable = |hit && (|(hit & SHARED) || !busy_i);

  always_comb begin
    if (hit == '0) resp = RespDecErr;
    else if (write_q ? writable : readable) resp = RespOkay;
    else resp = RespSlvErr;
  end

  assign re_o = req_q && !write_q && readable ? hit : '0;
  assign we_o = req_q && write_q && writable ? hit : '0;
  assign index_o = addr_q - base;
  assign wdata_o = wdata_q;

  assign busy_doorbell_o = req_q && write_q && busy_i && hit[Doorbell];
  assign busy_write_o = req_q && write_q && busy_i && |(hit & ~READ_ONLY) && !hit[Doorbell];
  assign torn_o = |(re_o & RESULTS) && busy_i;
  assign untorn_o = re_o[Observations] && index_o == '0 && !busy_i;

  logic late_valid_q, rvalid_q;
  logic [NumRegions-1:0] late_re_q;
  resp_e late_resp_q, resp_q;
  logic [DATA_WL-1:0] rdata, rdata_q;

  always_comb begin
    rdata = '0;
    for (int unsigned i = 0; i < NumRegions; i++) begin
      if (late_re_q[i]) rdata |= rdata_i[i];
    end
  end

  always_ff @(posedge clk_i or negedge rst_ni) begin
    if (!rst_ni) begin
      late_valid_q <= 1'b0;
      rvalid_q     <= 1'b0;
    end else begin
      late_valid_q <= req_q;
      rvalid_q     <= late_valid_q;
    end
  end

  always_ff @(posedge clk_i) begin
    late_re_q   <= re_o;
    late_resp_q <= resp;
    if (late_valid_q) begin
      rdata_q <= rdata;
      resp_q  <= late_resp_q;
    end
  end

  assign rvalid_o = rvalid_q;
  assign rdata_o  = rdata_q;
  assign resp_o   = resp_q;

endmodule
